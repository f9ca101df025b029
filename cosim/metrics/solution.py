"""What metrics are computed from: the signals of a motion, by a recording or an estimate."""

from __future__ import annotations

from typing import Protocol

from flexfmu.cosim.experiment.metric import Metric


class TimeSignal(Protocol):
    """A quantity over a span of time, with one or more channels and its time derivatives."""

    def peak(self) -> Metric:
        """Largest Euclidean norm over the channels."""
        ...

    def root_mean_square(self, order: int = 0) -> Metric:
        """Root mean square over time of the norm of the time derivative of this order."""
        ...

    def final(self, order: int = 0) -> Metric:
        """Norm of the time derivative of this order at the end of the span, as the left-hand limit."""
        ...


class PowerSignal(Protocol):
    """A power over a span of time, positive or negative."""

    def peak(self, sign: int) -> Metric:
        """Largest positive (sign 1) or negated negative (sign -1) power [W]; 0 where there is none."""
        ...

    def energy(self, sign: int) -> Metric:
        """Energy a cycle [J]: of the positive part (sign 1), of the negated negative part (-1), or the sum of both (0)."""
        ...

    def mean(self) -> Metric:
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

    def inertia_ratio(self, joint: int) -> Metric:
        """Largest inertia of the load over the rotor's, both seen by motor 1 or 2."""
        return Metric(None)

    def settling_time(self) -> Metric:
        """Time after the motion from which the residual vibration stays within the settling band [s]."""
        return Metric(None)
