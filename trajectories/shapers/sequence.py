"""Impulse sequences of input shapers, the vibration modes they are designed for, and their residual vibration.

An input shaper convolves a motion with a sequence Σ A_i δ(t - T_i). This multiplies the response of a mode with pole p by
|Σ A_i exp(-p T_i)|, the residual vibration (N. C. Singer, W. P. Seering, "Preshaping Command Inputs to Reduce System
Vibration", J. Dyn. Syst. Meas. Control 112, 1990).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.errors import TrajectoryError, positive
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.roots import root_between

SUM_ROUNDING = 1e-9
"""Largest deviation of the amplitudes' sum from 1 that counts as rounding of published amplitudes."""

SAME_IMPULSE = 1e-12
"""Fraction of the duration within which two impulses of a convolution coincide."""

TOUCH = 1e-6
"""Relative tolerance of a residual level: humps of EI shapers reach their tolerance exactly."""

FURTHEST = 100.0
"""Multiple of the design frequency up to which the end of the insensitive range is searched."""

FINENESS = 200
"""Samples per 1/duration, which is the width of the narrowest feature of a sensitivity curve."""


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
        """Return the factor exp(-ζ ω t) by which the amplitude decays in a time t [s]."""
        return math.exp(-self.ratio * self.angular_frequency * time)


def checked_ratio(ratio: float) -> float:
    """Return a damping ratio; raise TrajectoryError unless 0 ≤ ratio < 1."""
    if not 0.0 <= ratio < 1.0:
        raise TrajectoryError(f"damping ratio must be at least 0 and below 1 (it has to vibrate), got {ratio:g}")
    return float(ratio)


def checked_fraction(name: str, value: float) -> float:
    """Return a number; raise TrajectoryError unless it is above 0 and below 1."""
    if not 0.0 < value < 1.0:
        raise TrajectoryError(f"{name} must be above 0 and below 1 (0.05 is 5 %), got {value:g}")
    return float(value)


@dataclass(frozen=True)
class ImpulseSequence:
    """Impulses A_i at times T_i, the first at 0. The amplitudes add up to 1, so that a shaped motion keeps its end point.

    Attributes:
        times: T_i [s], ascending from 0.
        amplitudes: A_i, negative ones allowed.

    Raises:
        TrajectoryError: times and amplitudes differ in number, the times don't ascend from 0, or the amplitudes don't add up
            to 1.
    """

    times: tuple[float, ...]
    amplitudes: tuple[float, ...]

    def __post_init__(self) -> None:
        times, amplitudes = _numbers("times", self.times), _numbers("amplitudes", self.amplitudes)
        if len(times) != len(amplitudes) or not times:
            raise TrajectoryError(
                f"an impulse sequence needs as many times as amplitudes, at least one; got {len(times)} and {len(amplitudes)}"
            )
        # the first impulse starts the motion
        if times[0] != 0.0 or any(a >= b for a, b in pairwise(times)):
            raise TrajectoryError(f"impulse times must start at 0 and ascend, got {_listed(times)} s")
        # published amplitudes are rounded: normalise their sum
        total = math.fsum(amplitudes)
        if not abs(total - 1.0) <= SUM_ROUNDING * max(1.0, math.fsum(map(abs, amplitudes))):
            raise TrajectoryError(
                f"impulse amplitudes must add up to 1, or the motion ends elsewhere; {_listed(amplitudes)} add up to {total:.9g}"
            )
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "amplitudes", tuple(amplitude / total for amplitude in amplitudes))

    @property
    def duration(self) -> float:
        """Time of the last impulse [s], by which shaping lengthens a motion."""
        return self.times[-1]

    def residual(self, frequency: ArrayLike, ratio: float = 0.0) -> RealArray:
        """Return the residual vibration after the last impulse, relative to that of a single impulse at time 0.

        V = exp(-ζ ω T_n) sqrt(C² + S²) with C = Σ A_i exp(ζ ω T_i) cos(ω sqrt(1-ζ²) T_i), S likewise with the sine
        (Singer and Seering, "Preshaping Command Inputs to Reduce System Vibration", J. Dyn. Syst. Meas. Control 112,
        1990, eq. 10).

        Args:
            frequency: natural frequencies [Hz], zero or positive, a number or shape (N,).
            ratio: damping ratio ζ.

        Returns:
            V, shape (N,).
        """
        frequency = np.atleast_1d(np.asarray(frequency, dtype=float))
        bad = np.flatnonzero(~(np.isfinite(frequency) & (frequency >= 0.0)))
        if bad.size:
            raise TrajectoryError(
                f"frequencies must be zero or positive and finite, got {frequency[bad[0]]:g} Hz at index {bad[0]}"
            )
        # decay relative to the last impulse, so that no exponent has a positive real part
        omega = 2.0 * np.pi * frequency
        pole = complex(checked_ratio(ratio), math.sqrt(1.0 - ratio**2))
        exponents = np.outer(omega, pole * np.array(self.times) - ratio * self.duration)
        return np.asarray(np.abs(np.exp(exponents) @ np.array(self.amplitudes)))

    def insensitivity(self, frequency: float, level: float = 0.05, ratio: float = 0.0) -> float:
        """Return the width of the range around the design frequency in which the residual is at most ``level``.

        The width is divided by the design frequency: 0.4 means ±20 % (Singhose, Seering and Singer, "Residual Vibration
        Reduction Using Vector Diagrams to Generate Shaped Inputs", J. Mech. Des. 116, 1994). It is zero if the residual at the
        design frequency exceeds the level, infinite if the range has no upper end below 100 times that frequency.

        Args:
            frequency: design frequency [Hz].
            level: admissible residual, 0 to 1 exclusive.
            ratio: damping ratio.

        Raises:
            TrajectoryError: an argument is out of range.
        """
        positive("design frequency", frequency, "Hz")
        limit = checked_fraction("level", level) * (1.0 + TOUCH)
        if self.residual(frequency, ratio)[0] > limit or self.duration == 0.0:
            return 0.0
        # the ends of the range, from the design frequency downwards and upwards
        low = self._crossing(frequency, 0.0, limit, ratio)
        high = self._crossing(frequency, FURTHEST * frequency, limit, ratio)
        return (high - low) / frequency

    def _crossing(self, start: float, end: float, limit: float, ratio: float) -> float:
        """Return the first frequency [Hz] from ``start`` towards ``end`` at which the residual exceeds the limit."""
        # a grid fine enough for the narrowest feature, then the root within one interval
        count = max(FINENESS, math.ceil(FINENESS * abs(end - start) * self.duration))
        grid = np.linspace(start, end, count + 1)
        above = np.flatnonzero(self.residual(grid, ratio) > limit)
        if not above.size:
            return math.inf if end > start else 0.0
        return root_between(
            lambda frequency: float(self.residual(frequency, ratio)[0]) - limit, grid[above[0] - 1], grid[above[0]]
        )

    def convolve(self, other: ImpulseSequence) -> ImpulseSequence:
        """Return the convolution of both sequences, which cancels the modes of both; coinciding impulses are added."""
        # products of all pairs of impulses
        pairs = sorted(
            (t1 + t2, a1 * a2)
            for t1, a1 in zip(self.times, self.amplitudes, strict=True)
            for t2, a2 in zip(other.times, other.amplitudes, strict=True)
        )
        # add coinciding impulses
        near = SAME_IMPULSE * (self.duration + other.duration)
        times, amplitudes = [pairs[0][0]], [pairs[0][1]]
        for time, amplitude in pairs[1:]:
            if time - times[-1] <= near:
                amplitudes[-1] += amplitude
            else:
                times.append(time)
                amplitudes.append(amplitude)
        return ImpulseSequence(tuple(times), tuple(amplitudes))

    def split(self, sample_time: float) -> ImpulseSequence:
        """Return the sequence for a sampled signal: each impulse is split between the two samples around its time.

        The shares are linear in the distance (Murphy and Watanabe, "Digital Shaping Filters for Reducing Machine
        Vibration", IEEE Trans. Robotics and Automation 8, 1992). Moving each impulse to the nearest sample instead leaves ten
        to twenty times the residual.

        Args:
            sample_time: sample time of the signal [s].

        Raises:
            TrajectoryError: the sample time is not finite or not positive.
        """
        positive("sample time", sample_time, "s")
        shares: dict[int, float] = {}
        for time, amplitude in zip(self.times, self.amplitudes, strict=True):
            # add impulses at the same sample
            sample, later = sample_share(time, sample_time)
            for index, share in ((sample, 1.0 - later), (sample + 1, later)):
                if share:
                    shares[index] = shares.get(index, 0.0) + share * amplitude
        indices = sorted(shares)
        return ImpulseSequence(tuple(i * sample_time for i in indices), tuple(shares[i] for i in indices))


def sample_share(time: float, sample_time: float) -> tuple[int, float]:
    """Return the index of the sample at or before a time [s], and the share (0 to 1) of an impulse that the next sample gets."""
    # an impulse within rounding of a sample belongs to that sample alone
    position = time / sample_time
    sample = math.floor(position + SAME_IMPULSE * max(position, 1.0))
    return sample, max(position - sample, 0.0)


def _numbers(name: str, values: tuple[float, ...]) -> tuple[float, ...]:
    array = np.asarray(values, dtype=float)
    if array.ndim != 1 or not np.all(np.isfinite(array)):
        raise TrajectoryError(f"impulse {name} must be a sequence of finite numbers, got {values!r}")
    return tuple(float(value) for value in array)


def _listed(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)


UNSHAPED = ImpulseSequence((0.0,), (1.0,))
"""One impulse at time 0, which leaves a motion unchanged."""
