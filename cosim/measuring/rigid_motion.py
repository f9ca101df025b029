"""The rigid end-effector motion beside a recording, for comparison and plots."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexfmu.cosim.planning import MotionPlan
from flexfmu.cosim.results import Column, RealArray
from flexfmu.trajectories.trajectory import limits

KINDS = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s2"))
"""Order of the time derivative → its name and unit."""


class RigidMotion:
    """The rigid end-effector motion of a plan; for the same instants again it is calculated once."""

    def __init__(self, motion: MotionPlan) -> None:
        self._motion = motion
        self._time = np.empty(0)
        self._columns: Mapping[str, Column] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals."""
        return tuple(f"end_effector.reference.{kind}.{axis}" for kind, _ in KINDS for axis in "xy")

    def columns(self, time: RealArray) -> Mapping[str, Column]:
        """``end_effector.reference.position.x`` and so on at a recording's times, with their derivatives, on both sides of
        every instant that appears twice."""
        if not np.array_equal(time, self._time):
            self._time, self._columns = time, self._calculate(time)
        return self._columns

    def _calculate(self, time: RealArray) -> Mapping[str, Column]:
        left = np.append(time[:-1] == time[1:], False)
        derivatives = limits(self._motion.task, time, left, 4)
        return {
            f"end_effector.reference.{kind}.{axis}": Column(unit, *derivatives[order : order + 3, :, i].copy())
            for order, (kind, unit) in enumerate(KINDS)
            for i, axis in enumerate("xy")
        }
