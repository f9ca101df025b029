"""The vibration that a shaper is designed against: one damped oscillator."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexfmu.trajectories.checks import positive
from flexfmu.trajectories.errors import TrajectoryError


@dataclass(frozen=True)
class Oscillator:
    """A vibration mode x'' + 2 ζ ω x' + ω² x = 0.

    Attributes:
        frequency: undamped natural frequency ω / 2π [Hz].
        ratio: damping ratio ζ, 0 ≤ ζ < 1.

    Raises:
        TrajectoryError: the frequency isn't positive, or the ratio not from 0 to below 1.
    """

    frequency: float
    ratio: float = 0.0

    def __post_init__(self) -> None:
        positive("natural frequency", self.frequency, "Hz")
        checked_ratio(self.ratio)

    @property
    def angular_frequency(self) -> float:
        """ω [rad/s]."""
        return 2.0 * math.pi * self.frequency

    @property
    def damped_period(self) -> float:
        """2π / (ω sqrt(1 - ζ²)) [s]."""
        return 1.0 / (self.frequency * math.sqrt(1.0 - self.ratio**2))

    def decay(self, time: float) -> float:
        """What is left of the amplitude after a time [s]: exp(-ζ ω t)."""
        return math.exp(-self.ratio * self.angular_frequency * time)


def checked_ratio(ratio: float) -> float:
    """A damping ratio from 0 to below 1."""
    if not 0.0 <= ratio < 1.0:
        raise TrajectoryError(f"damping ratio must be at least 0 and below 1 (it has to vibrate), got {ratio:g}")
    return float(ratio)


def checked_fraction(name: str, value: float) -> float:
    """A number between 0 and 1, exclusive."""
    if not 0.0 < value < 1.0:
        raise TrajectoryError(f"{name} must be above 0 and below 1 (0.05 is 5 %), got {value:g}")
    return float(value)
