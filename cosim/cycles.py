"""A motion there and back again, many times: what learning controllers need."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.cosim.bernstein import Array
from flexfmu.cosim.errors import InputError
from flexfmu.cosim.planning import MotionPlan
from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.trajectory import Trajectory


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
        if self.cycles != int(self.cycles) or self.cycles < 1:
            raise InputError(f"the number of cycles must be 1 or more, got {self.cycles}")

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
        there = list(self.motion.breakpoints)
        back = [self._return + self.motion.duration - time for time in reversed(there)]
        points = [cycle * self.period + time for cycle in range(self.cycles) for time in (*there, *back)]
        return tuple(dict.fromkeys([*points[:-1], self.duration]))

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> Array:
        """Coordinates and their time derivatives; see `flexfmu.trajectories.trajectory.Trajectory.evaluate`."""
        instants = np.atleast_1d(np.asarray(time, dtype=float))
        cycle = np.clip(np.floor(instants / self.period), 0, self.cycles - 1)
        if side == "left":
            cycle = np.where((instants == cycle * self.period) & (cycle > 0), cycle - 1, cycle)
        within = instants - cycle * self.period
        there = self.motion.evaluate(within, order, side)
        opposite: Side = "left" if side == "right" else "right"
        back = self.motion.evaluate(self._return + self.motion.duration - within, order, opposite)
        signs = (-1.0) ** np.arange(order + 1)
        middle = self._return - 0.5 * self.dwell
        returning = within > middle if side == "left" else within >= middle
        return np.asarray(np.where(returning[:, np.newaxis], signs[:, np.newaxis, np.newaxis] * back, there))

    @property
    def _return(self) -> float:
        """When the way back begins within a cycle [s]."""
        return self.motion.duration + self.dwell


def repeated(plan: MotionPlan, cycles: int) -> MotionPlan:
    """A scene's motion there and back, its dwell between, again and again."""
    dwell = plan.scene.trajectory.dwell
    task, joints = (ThereAndBack(motion, dwell, cycles) for motion in (plan.task, plan.joints))
    return replace(plan, task=task, joints=joints)
