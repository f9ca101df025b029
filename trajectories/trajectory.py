"""Trajectories: motion in time, with one-sided derivatives of any order at its breakpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.checks import positive, times
from flexfmu.trajectories.curves import Piece, Side, checked_side
from flexfmu.trajectories.jets import Array, checked_order, compose
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.profiles import Profile, ProfilePiece, time_at

SAME_TIME = 1e-12
"""Fraction of the duration within which two times are the same: breakpoints that near are merged, and a time that
near to a breakpoint is at the breakpoint. Far above the rounding of integer ticks, far below any communication step."""


class Trajectory(Protocol):
    """A motion of two coordinates in time; standstill before 0 and after ``duration``."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        ...

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which some derivative may jump, sorted, 0 and ``duration`` included."""
        ...

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> Array:
        """Value and time derivatives.

        Args:
            time: a number or shape (N,) [s]; a number counts as N = 1.
            order: order of the highest derivative, any.
            side: the one-sided limit at breakpoints. At 0 the left one is standstill, at ``duration`` the right one.

        Returns:
            Coordinates and their derivatives (not divided by factorials), shape (order + 1, N, 2).

        Raises:
            TrajectoryError: a time isn't finite, or the order is negative.
        """
        ...


class Interval(NamedTuple):
    """A time interval in which the motion is analytic."""

    start: float
    profile: ProfilePiece
    piece: Piece
    piece_start: float


@dataclass(frozen=True)
class TaskTrajectory:
    """A path, run through with a profile within a duration: x and y [m] in time.

    Attributes:
        path: the path.
        profile: fraction of the path as a function of the fraction of the duration.
        duration: duration of the motion [s].
    """

    path: PickAndPlacePath
    profile: Profile
    duration: float

    def __post_init__(self) -> None:
        positive("trajectory duration", self.duration, "s")

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] of the profile's jumps and of the path's knots, 0 and the duration, sorted."""
        passages = [time_at(self.profile, knot / self.path.length) for knot in self.path.knots]
        return tuple(self.duration * eta for eta in _merged(self.profile.jumps, passages))

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> Array:
        """x and y [m] and their time derivatives; see `Trajectory.evaluate`."""
        time, order, side = times(time), checked_order(order), checked_side(side)
        tolerance = SAME_TIME * self.duration
        starts = np.array([interval.start for interval in self._intervals] + [self.duration])
        index = np.searchsorted(starts, time + (tolerance if side == "right" else -tolerance), side="right") - 1
        result = np.zeros((order + 1, len(time), 2))
        result[0, index < 0] = self.path.start
        result[0, index == len(self._intervals)] = self.path.end
        for i in np.unique(index):
            if 0 <= i < len(self._intervals):
                result[:, index == i] = self._motion(self._intervals[i], time[index == i], order)
        return result

    def _motion(self, interval: Interval, time: Array, order: int) -> Array:
        """Derivatives within one interval, shape (order + 1, N, 2)."""
        fraction = interval.profile.jet(time / self.duration, order).rescale(1.0 / self.duration)
        s = fraction * self.path.length - interval.piece_start
        x, y = interval.piece.jets(np.clip(s.value, 0.0, interval.piece.length), order)
        return np.stack([compose(x, s).derivatives(), compose(y, s).derivatives()], axis=-1)

    @cached_property
    def _intervals(self) -> tuple[Interval, ...]:
        """Intervals between breakpoints, split also where the profile changes its expansion."""
        joins = [piece.start for piece in self.profile.pieces[1:]]
        bounds = _merged([time / self.duration for time in self.breakpoints[1:-1]], joins)
        return tuple(self._interval(a, b) for a, b in pairwise(bounds))

    def _interval(self, start: float, end: float) -> Interval:
        middle = np.array([0.5 * (start + end)])
        profile = next(piece for piece in self.profile.pieces if middle[0] <= piece.end)
        curve = self.path.curve
        index = int(np.searchsorted(curve.knots, profile.jet(middle, 0).value[0] * curve.length))
        return Interval(start * self.duration, profile, curve.pieces[index], float(curve.edges[index]))


def _merged(first: Sequence[float], second: Sequence[float]) -> list[float]:
    """Fractions of the duration, sorted, from 0 to 1; of those within SAME_TIME the one named first is kept."""
    kept = [0.0, 1.0]
    for eta in (*first, *second):
        if min(abs(eta - other) for other in kept) > SAME_TIME:
            kept.append(eta)
    return sorted(kept)
