"""Repeated forward and reverse motions, for scenes with a way back and for learning controllers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Indices, RealArray
from flexfmu.cosim.experiment.planning import MotionPlan, Repetition
from flexfmu.trajectories.piecewise import Coordinates
from flexfmu.trajectories.trajectory import SAME_TIME, HasLimits, Trajectory, limits

ROUNDING = 4.0
"""Bound of rounding errors of times, in units in the last place of the longest time."""


@dataclass(frozen=True)
class ThereAndBack(HasLimits):
    """Cycles of a motion, a dwell, the motion reversed in time, and a dwell.

    Attributes:
        motion: the motion.
        dwell: duration of each dwell [s].
        cycles: number of cycles, at least 1.
    """

    motion: Trajectory
    dwell: float
    cycles: int

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

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `flexfmu.trajectories.trajectory.HasLimits`; instants at the same place of all cycles are evaluated once."""
        # the leg (motion and dwell) of each instant; at its ends the side decides
        instants = np.atleast_1d(np.asarray(time, dtype=float))
        near = max(SAME_TIME * self.motion.duration, ROUNDING * float(np.spacing(self.duration)))
        count = np.where(left, np.ceil((instants - near) / self._leg) - 1, np.floor((instants + near) / self._leg))
        leg = np.clip(count, 0, 2 * self.cycles - 1)
        back = leg % 2 == 1
        within = self._at_breakpoints(instants - leg * self._leg, back, near)
        # time and side within the motion, which reverse motions exchange; standstill is its outer limit at both ends
        duration = self.motion.duration
        own = np.where(back, duration - within, within)
        before = np.where(own < 0.0, True, np.where(own > duration, False, left != back))
        own = np.clip(own, 0.0, duration)
        first, place = _distinct(own, before, near)
        jets = limits(self.motion, own[first], before[first], order)[:, place]
        # in reverse motions odd derivatives change sign
        np.negative(jets[1::2], out=jets[1::2], where=back[:, np.newaxis])
        return jets

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


@dataclass(frozen=True)
class Reversed(HasLimits):
    """A motion, reversed in time.

    Attributes:
        motion: the motion.
        coordinates: what moves.
    """

    motion: Trajectory
    coordinates: Coordinates = "joints"

    @property
    def duration(self) -> float:
        """That of the motion [s]."""
        return self.motion.duration

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Breakpoints [s]."""
        return tuple(self.duration - point for point in reversed(self.motion.breakpoints))

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `flexfmu.trajectories.trajectory.HasLimits`."""
        jets = limits(self.motion, self.duration - np.atleast_1d(np.asarray(time, dtype=float)), ~left, order).copy()
        jets[1::2] *= -1.0
        return jets


def _distinct(time: RealArray, left: NDArray[np.bool_], near: float) -> tuple[Indices, Indices]:
    """The first of the instants that differ by at most ``near`` [s] and have the same side, and the index of each among them."""
    # sort by side and time, stable so that the first instant, whose rounding error is smallest, stays the first
    order = np.lexsort((time, left))
    apart = np.concatenate([[True], (np.diff(time[order]) > near) | (np.diff(left[order].astype(int)) > 0)])
    first = np.minimum.reduceat(order, np.flatnonzero(apart))
    place = np.empty_like(order)
    place[order] = np.cumsum(apart) - 1
    return first, place


def in_cycles(plan: MotionPlan) -> MotionPlan:
    """The plan of a single motion with the way back, cycles and pauses of its scene; the plan itself if there are none."""
    section = plan.scene.trajectory
    if section.way_back == "none" or plan.repetition is not None:
        return plan
    return repeated(plan, section.cycles, dwell=section.pause)


def repeated(plan: MotionPlan, cycles: int, sample_time: float | None = None, dwell: float | None = None) -> MotionPlan:
    """The plan with its motion repeated forward and reverse, with dwells between.

    Args:
        plan: plan of the single motion.
        cycles: number of cycles.
        sample_time: [s]; each dwell is extended so that motion and dwell are a whole number of samples. None keeps the
            dwell.
        dwell: duration of each dwell between two motions [s]; None for the scene's own dwell.

    Raises:
        InputError: the references are for the flexible robot.
    """
    if plan.design is not None:
        raise InputError(
            "references for the flexible robot are those of a single motion: its way back needs others; leave out "
            "`trajectory.references`, or the way back and controllers that learn"
        )
    dwell = plan.scene.trajectory.dwell if dwell is None else dwell
    if sample_time is not None:
        samples = ceil((plan.duration + dwell) / sample_time * (1.0 - 1e-9))
        dwell = max(samples * sample_time - plan.duration, 0.0)
    task, joints = (ThereAndBack(motion, dwell, cycles) for motion in (plan.task, plan.joints))
    return replace(plan, task=task, joints=joints, repetition=Repetition(plan, cycles, joints.period))
