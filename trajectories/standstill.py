"""A motion with standstill before and after it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.trajectories.curves import Side, checked_side
from flexfmu.trajectories.errors import times
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import Trajectory, limits, merged


@dataclass(frozen=True)
class Standstill:
    """A motion that begins after a standstill, and ends with one.

    Attributes:
        motion: the motion.
        time: duration of each standstill [s].
    """

    motion: Trajectory
    time: float

    @property
    def duration(self) -> float:
        """Duration with both standstills [s]."""
        return self.motion.duration + 2.0 * self.time

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Start and end [s], and the delayed breakpoints of the motion."""
        return merged([0.0, self.duration], [self.time + point for point in self.motion.breakpoints])

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return the coordinates and their time derivatives; see `flexfmu.trajectories.trajectory.Trajectory.evaluate`."""
        instants = times(time)
        return self.limits(instants, np.full(instants.shape, checked_side(side) == "left"), order)

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `flexfmu.trajectories.trajectory.HasLimits`."""
        return limits(self.motion, times(time) - self.time, left, order)
