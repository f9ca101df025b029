"""A motion there and back, repeated for learning controllers."""

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
"""Rounding error of a time after some operations, in units in the last place of the longest time."""


@dataclass(frozen=True)
class ThereAndBack:
    """A motion, a standstill, the motion reversed in time, a standstill; and so on.

    Attributes:
        motion: what is repeated.
        dwell: length of each standstill [s].
        cycles: how often it is repeated, at least once.

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
        """Length of a cycle [s]."""
        return 2.0 * (self.motion.duration + self.dwell)

    @property
    def duration(self) -> float:
        """From the first motion's start to the last one's end [s]."""
        return self.cycles * self.period - self.dwell

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Those of all motions [s]."""
        there = np.array(self.motion.breakpoints)
        back = self.motion.duration - there[::-1]
        legs = [leg * self._leg + (back if leg % 2 else there) for leg in range(2 * self.cycles)]
        points = np.concatenate([*legs[:-1], legs[-1][:-1], [self.duration]])
        distinct = np.diff(points, prepend=-np.inf) > SAME_TIME * self.duration
        return tuple(float(point) for point in points[distinct])

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Coordinates and their time derivatives; see `flexfmu.trajectories.trajectory.Trajectory.evaluate`."""
        # the leg of each instant; at its limits the side decides
        instants = np.atleast_1d(np.asarray(time, dtype=float))
        near = max(SAME_TIME * self.motion.duration, ROUNDING * float(np.spacing(self.duration)))
        count = (
            np.floor((instants + near) / self._leg) if side == "right" else np.ceil((instants - near) / self._leg) - 1
        )
        leg = np.clip(count, 0, 2 * self.cycles - 1)
        within = self._at_breakpoints(instants - leg * self._leg, leg % 2 == 1, near)
        # on the way back time runs backwards: odd derivatives change their sign, sides are exchanged
        there = self.motion.evaluate(within, order, side)
        opposite: Side = "left" if side == "right" else "right"
        back = self.motion.evaluate(self.motion.duration - within, order, opposite)
        signs = (-1.0) ** np.arange(order + 1)
        return np.asarray(np.where((leg % 2 == 1)[:, np.newaxis], signs[:, np.newaxis, np.newaxis] * back, there))

    def _at_breakpoints(self, within: RealArray, back: NDArray[np.bool_], near: float) -> RealArray:
        """Times from the start of a leg, exact where they mean a breakpoint: after hours, rounding of the time is larger than
        what the motion takes for the same instant, and limits would come from the wrong side."""
        there = np.array(self.motion.breakpoints)
        for points, here in ((there, ~back), (self.motion.duration - there[::-1], back)):
            after = points.searchsorted(within).clip(1, points.size - 1)
            nearest = np.where(within - points[after - 1] < points[after] - within, points[after - 1], points[after])
            within = np.where(here & (abs(within - nearest) <= near), nearest, within)
        return within

    @property
    def _leg(self) -> float:
        """Length of a motion with its standstill [s]."""
        return self.motion.duration + self.dwell


def repeated(plan: MotionPlan, cycles: int, sample_time: float | None = None) -> MotionPlan:
    """A scene's motion there and back, its dwell between, again and again.

    Args:
        plan: the motion.
        cycles: how often.
        sample_time: [s]; the dwell is lengthened to make each motion with its dwell a whole number of samples. None to
            leave it.

    Raises:
        InputError: the number of cycles isn't a positive whole number.
    """
    dwell = plan.scene.trajectory.dwell
    if sample_time is not None:
        samples = ceil((plan.duration + dwell) / sample_time * (1.0 - 1e-9))
        dwell = max(samples * sample_time - plan.duration, 0.0)
    task, joints = (ThereAndBack(motion, dwell, cycles) for motion in (plan.task, plan.joints))
    return replace(plan, task=task, joints=joints, repetition=Repetition(plan, cycles, joints.period))
