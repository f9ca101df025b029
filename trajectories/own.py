"""Own motions: positions that a user's class gives, as trajectories with derivatives.

Between two breakpoints the positions become a spline of degree 7 through equidistant samples, with six continuous derivatives. The
samples are doubled until the spline predicts the next ones; it then passes through those too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.trajectories.curves import Side, checked_side
from flexfmu.trajectories.errors import TrajectoryError, positive, times
from flexfmu.trajectories.jets import RealArray, checked_order
from flexfmu.trajectories.trajectory import SAME_TIME, Trajectory

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

DEGREE = 7
"""Degree of the splines: the references of a run need six derivatives of the position."""

FEWEST, MOST = 64, 8192
"""Numbers of intervals between two breakpoints of the first spline and of the last one that is tried."""

ACCURACY = 1e-12
"""Largest error of the samples that a spline predicts, relative to the motion's extent."""

AT_REST = 1e-6
"""Velocity relative to the largest one, below which the motion is at rest at its ends and does not jump at breakpoints."""


class OwnMotion(Protocol):
    """What a user's class has to offer.

    It may also have ``breakpoints``, the instants within the motion [s] at which its acceleration or a higher derivative jumps, and
    ``coordinates``, "end-effector" (the default) or "joints".
    """

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        ...

    def position(self, time: float) -> Sequence[float]:
        """Return x and y of the end effector [m], or q11 and q21 of the joints [rad], at a time from 0 to the duration [s]."""
        ...


@dataclass(frozen=True, eq=False)
class SplineTrajectory:
    """Splines between breakpoints; standstill before and after. See `flexfmu.trajectories.trajectory.Trajectory`.

    Attributes:
        duration: duration of the motion [s].
        breakpoints: times [s] at which splines meet, from 0 to the duration.
        splines: the splines of both coordinates by time, one between each two breakpoints.
    """

    duration: float
    breakpoints: tuple[float, ...]
    splines: tuple[BSpline, ...]

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return the coordinates and their time derivatives, (order + 1, N, 2); see `Trajectory.evaluate`."""
        time = times(time)
        return self.limits(time, np.full(time.shape, checked_side(side) == "left"), order)

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `flexfmu.trajectories.trajectory.HasLimits`."""
        time, order = times(time), checked_order(order)
        # the spline of each time: -1 before the motion, the number of splines after it
        near = SAME_TIME * self.duration
        index = np.searchsorted(self.breakpoints, time + np.where(left, -near, near), side="right") - 1
        index[index == len(self.breakpoints) - 1] = len(self.splines)
        result = np.zeros((order + 1, len(time), 2))
        result[0, index < 0] = self.splines[0](0.0)
        result[0, index == len(self.splines)] = self.splines[-1](self.duration)
        for i, spline in enumerate(self.splines):
            here = np.flatnonzero(index == i)
            if here.size:
                inside = np.clip(time[here], self.breakpoints[i], self.breakpoints[i + 1])
                for k in range(min(order, DEGREE) + 1):
                    result[k, here] = spline(inside, k)
        return result


def as_trajectory(motion: OwnMotion | Trajectory) -> Trajectory:
    """Return a motion as a trajectory: itself if it has the members of `Trajectory`, otherwise splines of its positions.

    Raises:
        TrajectoryError: something is missing, a position is not two finite numbers, the motion doesn't begin and end at rest, its
            velocity jumps, or it isn't smooth between its breakpoints.
    """
    if all(hasattr(motion, name) for name in ("duration", "breakpoints", "evaluate")):
        return cast(Trajectory, motion)
    for name in ("duration", "position"):
        if not hasattr(motion, name):
            raise TrajectoryError(
                f"{type(motion).__name__} has no `{name}`: an own motion needs `duration` [s] and `position(time)`"
            )
    # duration and breakpoints
    given: Any = motion.duration
    duration = positive("duration of the own motion", given() if callable(given) else given, "s")
    inner = sorted(float(point) for point in getattr(motion, "breakpoints", ()))
    points = (0.0, *(point for point in inner if SAME_TIME < point / duration < 1.0 - SAME_TIME), duration)
    # positions at many instants, one by one
    place = cast(OwnMotion, motion).position

    def sampled(at: RealArray) -> RealArray:
        return np.array([_checked(place(time), time) for time in at.tolist()])

    extent = float(np.ptp(sampled(np.linspace(0.0, duration, FEWEST)), axis=0).max())
    splines = tuple(_spline(sampled, begin, end, ACCURACY * extent) for begin, end in pairwise(points))
    trajectory = SplineTrajectory(duration, points, splines)
    _check_velocity(trajectory)
    return trajectory


def coordinates_of(motion: OwnMotion | Trajectory) -> str:
    """Return what a motion gives, "end-effector" or "joints".

    Raises:
        TrajectoryError: its ``coordinates`` are neither.
    """
    found = getattr(motion, "coordinates", "end-effector")
    if found not in ("end-effector", "joints"):
        raise TrajectoryError(f"`coordinates` of an own motion must be 'end-effector' or 'joints', got {found!r}")
    return str(found)


def _checked(position: Any, time: float) -> tuple[float, float]:
    """Return a position as two numbers."""
    try:
        first, second = (float(value) for value in position)
    except (TypeError, ValueError):
        raise TrajectoryError(f"position({time:g}) must return two numbers, got {position!r}") from None
    if not (np.isfinite(first) and np.isfinite(second)):
        raise TrajectoryError(f"position({time:g}) must return two finite numbers, got {position!r}")
    return first, second


def _spline(sampled: Callable[[RealArray], RealArray], begin: float, end: float, accuracy: float) -> BSpline:
    """Return the spline between two breakpoints; its samples are doubled until it predicts those between them."""
    from scipy.interpolate import make_interp_spline  # here, since few motions need scipy

    time = np.linspace(begin, end, FEWEST + 1)
    values = sampled(time)
    while True:
        # predict the samples halfway between the known ones
        middles = 0.5 * (time[1:] + time[:-1])
        between = sampled(middles)
        error = abs(make_interp_spline(time, values, DEGREE)(middles) - between).max(axis=1)
        time, values = _interleaved(time, middles), _interleaved(values, between)
        if error.max() <= accuracy:
            return make_interp_spline(time, values, DEGREE)
        if len(time) > MOST:
            worst = middles[int(error.argmax())]
            raise TrajectoryError(
                f"the own motion isn't smooth near {worst:.6g} s: add this instant to its `breakpoints` if its acceleration or a "
                "higher derivative jumps there; position and velocity must not"
            )


def _interleaved(first: RealArray, second: RealArray) -> RealArray:
    """Return the elements of both arrays in turn, one more of the first one."""
    result = np.empty((len(first) + len(second), *first.shape[1:]))
    result[::2], result[1::2] = first, second
    return result


def _check_velocity(motion: SplineTrajectory) -> None:
    """Raise TrajectoryError unless the motion begins and ends at rest, without a jump of the velocity between."""
    points = np.array(motion.breakpoints)
    largest = abs(motion.evaluate(np.linspace(0.0, motion.duration, 1000), 1)[1]).max()
    jumps = abs(motion.evaluate(points, 1, "right")[1] - motion.evaluate(points, 1, "left")[1]).max(axis=1)
    worst = int(jumps.argmax())
    if jumps[worst] > AT_REST * largest:
        raise TrajectoryError(
            f"the velocity of the own motion jumps by {jumps[worst]:.4g} per second at {points[worst]:.6g} s: it must begin and "
            "end at rest, and its velocity must be continuous"
        )
