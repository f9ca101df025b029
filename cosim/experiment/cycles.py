"""Repeated forward and reverse motions, for learning controllers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan, Repetition
from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.trajectory import SAME_TIME, Trajectory

ROUNDING = 4.0
"""Bound of rounding errors of times, in units in the last place of the longest time."""


@dataclass(frozen=True)
class ThereAndBack:
    """Cycles of a motion, a dwell, the motion reversed in time, and a dwell.

    Attributes:
        motion: the motion.
        dwell: duration of each dwell [s].
        cycles: number of cycles, at least 1.

    Raises:
        InputError: the dwell is negative, or the number of cycles isn't a positive whole number.
    """

    motion: Trajectory
    dwell: float
    cycles: int

    def __post_init__(self) -> None:
        if not 0.0 <= self.dwell < np.inf:
            raise InputError(f"the dwell between two motions must be zero or positive, got {self.dwell} s")
        if not (isinstance(self.cycles, Integral) and self.cycles >= 1):
            raise InputError(f"the number of cycles must be a whole number from 1, got {self.cycles}")

    @property
    def period(self) -> float:
        """Duration of a cycle [s]."""
        return 2.0 * (self.motion.duration + self.dwell)

    @property
    def duration(self) -> float:
        """Time from the start of the first motion to the end of the last one [s]."""
        return self.cycles * self.period - self.dwell

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Breakpoints of all motions [s]."""
        there = np.array(self.motion.breakpoints)
        back = self.motion.duration - there[::-1]
        legs = [leg * self._leg + (back if leg % 2 else there) for leg in range(2 * self.cycles)]
        points = np.concatenate([*legs[:-1], legs[-1][:-1], [self.duration]])
        distinct = np.diff(points, prepend=-np.inf) > SAME_TIME * self.duration
        return tuple(float(point) for point in points[distinct])

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Coordinates and their time derivatives; see `flexfmu.trajectories.trajectory.Trajectory.evaluate`."""
        # the leg (motion and dwell) of each instant; at its ends ``side`` decides
        instants = np.atleast_1d(np.asarray(time, dtype=float))
        near = max(SAME_TIME * self.motion.duration, ROUNDING * float(np.spacing(self.duration)))
        count = (
            np.floor((instants + near) / self._leg) if side == "right" else np.ceil((instants - near) / self._leg) - 1
        )
        leg = np.clip(count, 0, 2 * self.cycles - 1)
        within = self._at_breakpoints(instants - leg * self._leg, leg % 2 == 1, near)
        # in reverse motions odd derivatives change sign, and sides are exchanged
        there = self.motion.evaluate(within, order, side)
        opposite: Side = "left" if side == "right" else "right"
        back = self.motion.evaluate(self.motion.duration - within, order, opposite)
        signs = (-1.0) ** np.arange(order + 1)
        return np.asarray(np.where((leg % 2 == 1)[:, np.newaxis], signs[:, np.newaxis, np.newaxis] * back, there))

    def _at_breakpoints(self, within: RealArray, back: NDArray[np.bool_], near: float) -> RealArray:
        """Times from the start of a leg, snapped to breakpoints within ``near`` [s].

        After hours, rounding errors exceed the tolerance of the motion, and limits would be from the wrong side.
        """
        there = np.array(self.motion.breakpoints)
        for points, here in ((there, ~back), (self.motion.duration - there[::-1], back)):
            after = points.searchsorted(within).clip(1, points.size - 1)
            nearest = np.where(within - points[after - 1] < points[after] - within, points[after - 1], points[after])
            within = np.where(here & (abs(within - nearest) <= near), nearest, within)
        return within

    @property
    def _leg(self) -> float:
        """Duration of a motion with its dwell [s]."""
        return self.motion.duration + self.dwell


def repeated(plan: MotionPlan, cycles: int, sample_time: float | None = None) -> MotionPlan:
    """The plan with its motion repeated forward and reverse, with dwells between.

    Args:
        plan: plan of the single motion.
        cycles: number of cycles.
        sample_time: [s]; each dwell is extended so that motion and dwell are a whole number of samples. None keeps the
            dwell.

    Raises:
        InputError: the number of cycles isn't a positive whole number.
    """
    dwell = plan.scene.trajectory.dwell
    if sample_time is not None:
        samples = ceil((plan.duration + dwell) / sample_time * (1.0 - 1e-9))
        dwell = max(samples * sample_time - plan.duration, 0.0)
    task, joints = (ThereAndBack(motion, dwell, cycles) for motion in (plan.task, plan.joints))
    return replace(plan, task=task, joints=joints, repetition=Repetition(plan, cycles, joints.period))
