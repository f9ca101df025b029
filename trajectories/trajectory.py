"""Trajectories: motion in time, with one-sided derivatives of any order at its breakpoints.

Breakpoints are the jumps of the profile and the times at which the motion passes knots of the path. Between them the motion is
analytic: its series is the composition of the curve's series in arc length with the profile's series in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.trajectories.curves import PlacedPiece, Side, checked_side
from flexfmu.trajectories.errors import positive, times
from flexfmu.trajectories.jets import Jet, RealArray, checked_order, compose, stack
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.profiles import Profile, SmoothPiece, time_at

SAME_TIME = 1e-12
"""Fraction of the duration within which two times count as equal: such breakpoints are merged, and a time so close to a breakpoint
is at the breakpoint. Far above the rounding of integer ticks, far below any communication step."""


SAMPLES_PER_INTERVAL = 200
"""Initial samples of margins and angles between two breakpoints, so dense that a margin has at most one minimum between two of
them."""

MOST_SAMPLES, LEAST_SAMPLES = 40_000, 8
"""Samples of a motion with many breakpoints, such as a spline, and fewest samples between two of them."""


class Trajectory(Protocol):
    """A motion of two coordinates in time; standstill before 0 and after ``duration``."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which a derivative of some order may jump, ascending from 0 to ``duration``."""

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return the coordinates and their time derivatives.

        Args:
            time: a number or shape (N,) [s]; a number counts as N = 1.
            order: order of the highest derivative, any.
            side: the one-sided limit at breakpoints. The left limit at 0 and the right limit at ``duration`` are standstill.

        Returns:
            Coordinates and their derivatives (not divided by factorials), shape (order + 1, N, 2).

        Raises:
            TrajectoryError: a time isn't finite, the order is negative, or ``side`` is unknown.
        """


@runtime_checkable
class HasLimits(Protocol):
    """A trajectory that evaluates left limits at some times and right limits at others in one call."""

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """Return the coordinates and their time derivatives, (order + 1, N, 2), as `Trajectory.evaluate` does.

        Args:
            time: shape (N,) [s].
            left: shape (N,), True for the left limit, False for the right one.
            order: order of the highest derivative, any.
        """

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return the coordinates and their time derivatives, (order + 1, N, 2); see `Trajectory.evaluate`."""
        instants = times(time)
        return self.limits(instants, np.full(instants.shape, checked_side(side) == "left"), order)


def limits(trajectory: Trajectory, time: RealArray, left: NDArray[np.bool_], order: int) -> RealArray:
    """Return one-sided limits of any trajectory, (order + 1, N, 2); see `HasLimits`."""
    if isinstance(trajectory, HasLimits):
        return trajectory.limits(time, left, order)
    result = trajectory.evaluate(time, order, "right")
    if left.any():
        result[:, left] = trajectory.evaluate(time[left], order, "left")
    return result


class MotionInterval(NamedTuple):
    """A time interval in which the motion is analytic.

    Attributes:
        start: its start as a fraction of the duration.
        profile: piece of the profile in this interval.
        piece: piece of the path in this interval.
        piece_start: arc length of the path at the start of ``piece`` [m].
    """

    start: float
    profile: SmoothPiece
    piece: PlacedPiece
    piece_start: float


@dataclass(frozen=True)
class TaskTrajectory(HasLimits):
    """Motion of the end effector along a path with a motion profile: x and y [m] in time.

    Attributes:
        path: the path.
        profile: fraction of the path as a function of the fraction of the duration.
        duration: duration of the motion [s].

    Raises:
        TrajectoryError: the duration is not finite or not positive.
    """

    path: PickAndPlacePath
    profile: Profile
    duration: float

    def __post_init__(self) -> None:
        positive("trajectory duration", self.duration, "s")

    def with_duration(self, duration: float) -> TaskTrajectory:
        """Return the same motion, faster or slower; what depends on path and profile alone is shared.

        Raises:
            TrajectoryError: the duration is not finite or not positive.
        """
        other = replace(self, duration=duration)
        other.__dict__["_shape"] = self._shape
        return other

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] of the profile's jumps and of the path's knots, ascending from 0 to the duration."""
        return tuple(self.duration * eta for eta in self._shape.breakpoints)

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `HasLimits`."""
        time, order = times(time), checked_order(order)
        # index of the interval of each time: -1 before the motion, the number of intervals after it
        tolerance = SAME_TIME * self.duration
        intervals, starts = self._shape.intervals, self.duration * self._shape.edges
        index = np.searchsorted(starts, time + np.where(left, -tolerance, tolerance), side="right") - 1
        # intervals on congruent curves are evaluated together
        result = np.zeros((order + 1, len(time), 2))
        for group in self._shape.congruent:
            here = [(intervals[i], np.flatnonzero(index == i)) for i in group if (index == i).any()]
            if not here:
                continue
            # series of the arc length in time, in the direction of the unplaced piece
            arcs = []
            for interval, where in here:
                fraction = interval.profile.jet(time[where] / self.duration, order).rescale(1.0 / self.duration)
                arc = interval.piece.own_arc_length(fraction * self.path.length - interval.piece_start)
                arcs.append(arc.coefficients)
            s = Jet(np.concatenate(arcs, axis=1))
            # evaluate the curve at all arc lengths, then place each part
            piece = here[0][0].piece.piece
            points = compose(stack(piece.jets(np.clip(s.value, 0.0, piece.length), order)), s).coefficients
            begin = 0
            for interval, where in here:
                part = interval.piece.placed(points[:, :, begin : begin + where.size])
                result[:, where] = Jet(part).derivatives()
                begin += where.size
        # standstill outside the motion, which both limits at its ends continue to the last bit
        result[0, time <= tolerance] = self.path.start
        result[0, time >= self.duration - tolerance] = self.path.end
        return result

    @cached_property
    def _shape(self) -> MotionShape:
        return shape_of(self.path, self.profile)


@dataclass(frozen=True, eq=False)
class MotionShape:
    """What a motion along a path is but for its duration; times are fractions of the duration.

    Attributes:
        breakpoints: the profile's jumps and the passages of the path's knots, ascending from 0 to 1.
        intervals: intervals between breakpoints, further divided where pieces of the profile meet.
        edges: starts of the intervals, and 1 (intervals + 1,).
        congruent: numbers of intervals on congruent pieces (equal except for their placement), group by group.
    """

    breakpoints: tuple[float, ...]
    intervals: tuple[MotionInterval, ...]
    edges: RealArray
    congruent: tuple[tuple[int, ...], ...]


def shape_of(path: PickAndPlacePath, profile: Profile) -> MotionShape:
    """Return the shape of the motion along a path with a profile."""
    # jumps first, so that a knot passed at the time of a jump is merged into it
    passages = [time_at(profile, knot / path.length) for knot in path.knots]
    breakpoints = merged([0.0, 1.0], [*profile.jumps, *passages])
    # breakpoints first, so that a join of the profile at a breakpoint is merged into it
    joins = [piece.start for piece in profile.pieces[1:]]
    curve, intervals = path.curve, []
    for start, end in pairwise(merged([0.0, 1.0], [*breakpoints[1:-1], *joins])):
        # the midpoint identifies the pieces of profile and curve without ambiguity
        middle = np.array([0.5 * (start + end)])
        part = next(piece for piece in profile.pieces if middle[0] <= piece.end)
        index = int(np.searchsorted(curve.knots, part.jet(middle, 0).value[0] * curve.length))
        intervals.append(MotionInterval(start, part, path.pieces[index], float(curve.edges[index])))
    # groups of congruent pieces
    groups: dict[int, list[int]] = {}
    for i, interval in enumerate(intervals):
        groups.setdefault(id(interval.piece.piece), []).append(i)
    edges = np.array([*(interval.start for interval in intervals), 1.0])
    return MotionShape(breakpoints, tuple(intervals), edges, tuple(map(tuple, groups.values())))


def merged(kept: Sequence[float], others: Sequence[float], near: float = SAME_TIME) -> tuple[float, ...]:
    """Merge times: return all of ``kept`` and those of ``others`` that are further than ``near`` from every earlier one, ascending."""
    found = list(kept)
    for time in others:
        if min(abs(time - other) for other in found) > near:
            found.append(time)
    return tuple(sorted(found))


def sampled_positions(task: Trajectory) -> tuple[RealArray, RealArray]:
    """Return sample times (N,) [s] from 0 to the duration, breakpoints included, and end-effector positions (N, 2) [m]."""
    count = min(SAMPLES_PER_INTERVAL, max(MOST_SAMPLES // len(task.breakpoints), LEAST_SAMPLES))
    spans = [np.linspace(a, b, count, endpoint=False) for a, b in pairwise(task.breakpoints)]
    time = np.concatenate([*spans, [task.duration]])
    return time, np.asarray(task.evaluate(time, 0)[0])


def positions_along(motion: Trajectory, fractions: ArrayLike) -> RealArray:
    """Return positions (N, 2) [m] at fractions (N,) of the path's length, from start to end.

    They are exact for a `TaskTrajectory`. For other motions the path is that of thousands of samples: a place is known to
    about a millionth of the path's length.

    Args:
        motion: motion of the end effector, x and y [m].
        fractions: 0 to 1.
    """
    share = np.atleast_1d(np.asarray(fractions, dtype=float))
    if isinstance(motion, TaskTrajectory):
        return np.stack([jet.value for jet in motion.path.jets(share * motion.path.length, order=0)], axis=-1)
    _, positions = sampled_positions(motion)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])
    return np.stack([np.interp(share * arc[-1], arc, coordinate) for coordinate in positions.T], axis=-1)
