"""What metrics are computed from: the signals of a motion, by a recording or an estimate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Measurement:
    """The value of one metric, in its SI unit: with a companion run the companion's, which is the more accurate one.

    Attributes:
        value: the value; None where the metric doesn't exist (no dwell, not settled, run cut short).
        interpolation_error: estimated error of the interpolation between the run's communication points, a part of its error.
        error: estimated error of the value; None where it isn't known.
        own, own_error: value and error of the run itself; None without a companion, when ``value`` is the run's.
        rounding: rounding error that exceeds that of the signals themselves, a part of the error.
        reason: the run's message where the run failed and the metric has no value; otherwise empty.
    """

    value: float | None
    interpolation_error: float = 0.0
    error: float | None = None
    own: float | None = None
    own_error: float | None = None
    rounding: float = 0.0
    reason: str = ""


class TimeSignal(Protocol):
    """A quantity over a span of time, with one or more channels and its time derivatives."""

    def peak(self) -> Measurement:
        """Largest Euclidean norm over the channels."""
        ...

    def root_mean_square(self, order: int = 0) -> Measurement:
        """Root mean square over time of the norm of the time derivative of this order."""
        ...

    def final(self, order: int = 0) -> Measurement:
        """Norm of the time derivative of this order at the end of the span, as the left-hand limit."""
        ...


class PowerSignal(Protocol):
    """A power over a span of time, positive or negative."""

    def peak(self, sign: int) -> Measurement:
        """Largest positive (sign 1) or negated negative (sign -1) power [W]; 0 where there is none."""
        ...

    def energy(self, sign: int) -> Measurement:
        """Energy a cycle [J]: of the positive part (sign 1), of the negated negative part (-1), or the sum of both (0)."""
        ...

    def mean(self) -> Measurement:
        """Mean over time [W]."""
        ...


class Solution:
    """The signals of a motion; None for a signal that the robot or the solution doesn't have.

    Motion means 0 < t < T with one-sided limits at both ends; the dwell follows it.
    """

    def torque(self, joint: int) -> TimeSignal | None:
        """Torque of motor 1 or 2 over the motion [N.m]."""

    def modal_deflection(self) -> TimeSignal | None:
        """First bending coordinate of proximal link 1 over the motion [m]; zero for a rigid link."""

    def tip_deflection(self, leg: int) -> TimeSignal | None:
        """Transverse displacement of the tip of proximal link 1 or 2 over the motion [m]; zero for a rigid link."""

    def path_error(self) -> TimeSignal | None:
        """Deviation of the end effector from the rigid robot's over motion and dwell [m]."""

    def path_error_in_motion(self) -> TimeSignal | None:
        """Deviation of the end effector from the rigid robot's over the motion alone [m]."""

    def residual_vibration(self) -> TimeSignal | None:
        """Deviation of the end effector from the equilibrium at the end pose during the dwell [m]."""

    def tracking_error(self, joint: int) -> TimeSignal | None:
        """Angle of motor 1 or 2 minus its planned angle, over motion and dwell [rad]."""

    def tracking_error_in_motion(self, joint: int) -> TimeSignal | None:
        """Angle of motor 1 or 2 minus its planned angle, over the motion alone [rad]."""

    def duty_torque(self, joint: int) -> TimeSignal | None:
        """Torque of motor 1 or 2 over the duty cycle: all motions and standstills [N.m]."""

    def duty_speed(self, joint: int) -> TimeSignal | None:
        """Angular velocity of motor 1 or 2 over the duty cycle [rad/s]."""

    def duty_power(self, joint: int) -> PowerSignal | None:
        """Mechanical power of motor 1 or 2 over the duty cycle, positive into the robot [W]."""

    def inertia_ratio(self, joint: int) -> Measurement:
        """Largest inertia of the load over the rotor's, both seen by motor 1 or 2."""
        return Measurement(None)

    def settling_time(self) -> Measurement:
        """Time after the motion from which the residual vibration stays within the settling band [s]."""
        return Measurement(None)
