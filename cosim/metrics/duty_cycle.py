"""Speed and mechanical power of the motors over the duty cycle, as Hermite segments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.analysis import analyse
from flexfmu.cosim.metrics.segments import HermiteSegments
from flexfmu.cosim.metrics.signals import TORQUES, at_ends, segments
from flexfmu.cosim.metrics.solution import Measurement

if TYPE_CHECKING:
    from flexfmu.trajectories.trajectory import Trajectory


SHAPE = 2.0 / 3.0
"""Largest mean of an interpolation error over a segment in terms of its peak: that of theta (1 - theta); others are slimmer."""


def joint_speed(recording: Recording, joint: int, planned: Trajectory | None) -> HermiteSegments | None:
    """Return the angular velocity of a motor [rad/s] with two derivatives; None where it isn't known.

    Args:
        recording: of any robot; its joint velocity or its reference, where that drives the motors.
        joint: 0 or 1.
        planned: joint trajectory, used where neither was recorded.
    """
    for name in (f"joint{joint + 1}.velocity", f"joint{joint + 1}.reference.velocity"):
        if name in recording.columns:
            return segments(recording, [name])
    if planned is None:
        return None
    torque = segments(recording, TORQUES[joint : joint + 1])
    # the fourth derivative comes along, as for other metrics, which share the table
    begin, end = (each[1:4, :, joint : joint + 1] for each in at_ends(torque, planned, 4))
    return HermiteSegments(torque.start, torque.end, begin, end)


def product(first: HermiteSegments, second: HermiteSegments) -> HermiteSegments:
    """Return the product of two signals with one channel and two derivatives each, by Leibniz' rule."""

    def derivatives(u: RealArray, v: RealArray) -> RealArray:
        return np.stack([u[0] * v[0], u[1] * v[0] + u[0] * v[1], u[2] * v[0] + 2.0 * u[1] * v[1] + u[0] * v[2]])

    left, right = derivatives(first.left, second.left), derivatives(first.right, second.right)
    return HermiteSegments(first.start, first.end, left, right)


@dataclass(frozen=True)
class RecordedPower:
    """A power, interpolated between communication points; see `flexfmu.cosim.metrics.solution.PowerSignal`."""

    segments: HermiteSegments
    cycles: int

    @cached_property
    def _parts(self) -> tuple[float, ...]:
        return analyse(self.segments).parts()

    def peak(self, sign: int) -> Measurement:
        """Largest positive or negated negative power."""
        return Measurement(self._parts[0 if sign > 0 else 1], self._parts[4])

    def energy(self, sign: int) -> Measurement:
        """Energy a cycle of the positive part, of the negated negative part, or the sum of both."""
        positive, negative = (
            Measurement(self._parts[2 + k] / self.cycles, SHAPE * self._parts[5 + k] / self.cycles) for k in (0, 1)
        )
        return self._difference(self.cycles) if sign == 0 else positive if sign > 0 else negative

    def mean(self) -> Measurement:
        """Mean over time."""
        return self._difference(float(self.segments.duration.sum()))

    def _difference(self, divisor: float) -> Measurement:
        """Return the integral of both parts over a divisor."""
        _, _, positive, negative, _, first, second = self._parts
        return Measurement((positive - negative) / divisor, SHAPE * (first + second) / divisor)
