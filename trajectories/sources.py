"""Motions of others as ours: trajectories of ruckig, toppra and splines of scipy, and positions that a user's class gives.

The libraries give polynomials between knots, which are taken as they are: nothing is sampled, and where a derivative jumps is a
breakpoint. A motion of the robot has two coordinates, and starts and ends at rest.

Sources: L. Berscheid, T. Kröger, Jerk-limited real-time trajectory generation with arbitrary target states, RSS 2021 (ruckig);
H. Pham, Q.-C. Pham, A new approach to time-optimal path parameterization based on reachability analysis, IEEE Trans. Robot.
34 (2018) (toppra).

Positions of a user's class become polynomials of degree 10 in time, on intervals that are halved until every other sample predicts
those between them. The samples are at Chebyshev points, where interpolation is nearly optimal (L. N. Trefethen, *Approximation Theory
and Approximation Practice*, SIAM 2013, chapters 2 to 8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import comb
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.polynomial import chebyshev

from flexfmu.trajectories.errors import TrajectoryError, positive
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import Coordinates, PiecewisePolynomial, moved
from flexfmu.trajectories.trajectory import SAME_TIME, Trajectory, merged

AXES = 2
"""Coordinates of a motion of the robot."""


class PolynomialPieces(NamedTuple):
    """Polynomials one after the other.

    Attributes:
        starts: ascending, shape (K,).
        end: end of the last one.
        taylor: Taylor coefficients about the starts, (degree + 1, K, coordinates).
    """

    starts: RealArray
    end: float
    taylor: RealArray

    def about(self, points: RealArray, middles: RealArray) -> RealArray:
        """Return Taylor coefficients (degree + 1, N, coordinates) about points (N,) of the pieces that hold ``middles`` (N,)."""
        piece = (np.searchsorted(self.starts, middles, side="right") - 1).clip(0)
        return moved(self.taylor[:, piece], (points - self.starts[piece])[:, np.newaxis])


def from_scipy(spline: Any, coordinates: Coordinates = "joints") -> PiecewisePolynomial:
    """Return the motion of a scipy `PPoly`, `CubicSpline` or `BSpline` of time [s] with two coordinates.

    Time counts from the spline's start, that of a B-spline from the start of its base interval.

    Args:
        spline: the motion.
        coordinates: what moves: "joints" for q11, q21 [rad], or "end-effector" for x, y [m].

    Raises:
        TrajectoryError: it is something else, or hasn't two coordinates.
    """
    pieces = _pieces_of(spline)
    _check_axes(pieces.taylor.shape[2])
    return PiecewisePolynomial(np.append(pieces.starts, pieces.end) - pieces.starts[0], pieces.taylor, coordinates)


def from_ruckig(trajectory: Any, coordinates: Coordinates = "joints") -> PiecewisePolynomial:
    """Return the motion of a `ruckig.Trajectory`: cubic polynomials between the jumps of either axis's jerk.

        otg, motion = ruckig.Ruckig(2), ruckig.Trajectory(2)
        otg.calculate(limits, motion)
        from_ruckig(motion)

    Args:
        trajectory: the motion.
        coordinates: what moves, as for `from_scipy`.

    Raises:
        TrajectoryError: it is something else, hasn't two degrees of freedom, or isn't calculated.
    """
    try:
        sections, axes, duration = trajectory.profiles, trajectory.degrees_of_freedom, trajectory.duration
    except AttributeError:
        raise TrajectoryError(f"expected a ruckig.Trajectory, got {type(trajectory).__name__}") from None
    _check_axes(axes)
    if not duration > 0.0:
        raise TrajectoryError("the ruckig trajectory has a duration of 0 s: calculate it first, and check the result")
    # phases of each axis, and where either axis changes its phase
    ends = [*trajectory.intermediate_durations[: len(sections) - 1], duration]
    phases = [_phases([section[axis] for section in sections], [0.0, *ends[:-1]]) for axis in range(axes)]
    starts = np.concatenate([each.starts for each in phases])
    inner = starts[(starts > SAME_TIME * duration) & (starts < duration * (1.0 - SAME_TIME))]
    knots = np.array(merged([0.0, duration], inner.tolist(), SAME_TIME * duration))
    middles = 0.5 * (knots[:-1] + knots[1:])
    taylor = np.concatenate([each.about(knots[:-1], middles) for each in phases], axis=2)
    return PiecewisePolynomial(knots, taylor, coordinates)


def from_toppra(trajectory: Any, coordinates: Coordinates = "joints") -> PiecewisePolynomial:
    """Return the motion that a toppra algorithm's `compute_trajectory` gives with `ParametrizeSpline`, its default: a cubic spline.

    Args:
        trajectory: the motion.
        coordinates: what moves, as for `from_scipy`.

    Raises:
        TrajectoryError: it is something else, or hasn't two degrees of freedom.
    """
    if trajectory is None:
        raise TrajectoryError("toppra found no trajectory: relax its limits, or move the path")
    if hasattr(trajectory, "cspl"):
        return from_scipy(trajectory.cspl, coordinates)
    raise TrajectoryError(
        f"expected what toppra's compute_trajectory returns, got {type(trajectory).__name__}: choose "
        'parametrizer="ParametrizeSpline"'
    )


def _check_axes(axes: int) -> None:
    if axes != AXES:
        raise TrajectoryError(f"the trajectory has {axes} coordinates, the robot's motions have {AXES}")


def _pieces_of(spline: Any) -> PolynomialPieces:
    """The polynomials of a scipy spline.

    Raises:
        TrajectoryError: it is something else.
    """
    from scipy.interpolate import BSpline, PPoly  # here, since other motions need no scipy

    if isinstance(spline, BSpline) and spline.c.ndim == 2:
        # knots beyond the base interval are not part of the motion
        x, first, last = spline.t, spline.t[spline.k], spline.t[len(spline.t) - 1 - spline.k]
        c = np.stack([PPoly.from_spline((x, column, spline.k)).c for column in spline.c.T], axis=-1)
    elif isinstance(spline, PPoly) and spline.c.ndim == 3:
        x, first, last, c = spline.x, spline.x[0], spline.x[-1], spline.c
    else:
        raise TrajectoryError(f"expected a PPoly, CubicSpline or BSpline of vectors, got {type(spline).__name__}")
    wide = (np.diff(x) > 0.0) & (x[:-1] >= first) & (x[1:] <= last)
    return PolynomialPieces(x[:-1][wide], float(last), np.ascontiguousarray(c[::-1, wide]))


def _phases(profiles: Sequence[Any], starts: Sequence[float]) -> PolynomialPieces:
    """Phases of constant jerk of an axis of ruckig: braking, seven phases, and again braking in each section."""
    times, taylor = list[float](), list[list[float]]()
    for profile, start in zip(profiles, starts, strict=True):
        time = start
        for part in (profile.brake, profile, profile.accel):
            # a profile has no braking where its times are zero
            for width, p, v, a, j in zip(part.t, part.p, part.v, part.a, part.j, strict=False):
                if width > 0.0:
                    times.append(time)
                    taylor.append([p, v, 0.5 * a, j / 6.0])
                    time += width
        # an axis may wait for the others at its end
        times.append(time)
        taylor.append([profile.pf, profile.vf, 0.5 * profile.af, 0.0])
    return PolynomialPieces(np.array(times), times[-1], np.array(taylor).T[:, :, np.newaxis])


DEGREE = 10
"""Degree of the polynomials."""

NODES = -np.cos(np.pi * np.arange(17) / 16)
"""Chebyshev points, from -1 to 1; every other one predicts the rest."""

ACCURACY = 1e-12
"""Largest error of predicted samples relative to the motion's extent; that of the polynomials, through all samples, is below rounding."""

ROUNDING = 16 * np.finfo(float).eps
"""Rounding errors of predicted samples, relative to the largest position; in small motions they exceed `ACCURACY`."""

SHORTEST = 1e-4
"""Half of the shortest interval as a fraction of the duration; what needs a shorter one isn't smooth."""

SAMPLES = 200
"""Samples for the motion's extent."""

AT_REST = 1e-6
"""Velocity relative to the largest one, below which the motion is at rest at its ends and does not jump at breakpoints."""


_COARSE = chebyshev.chebvander(NODES, len(NODES) // 2)
PREDICTION = _COARSE @ np.linalg.inv(_COARSE[::2])
"""Matrix from values at every other node to those of their polynomial at all nodes."""

CHEBYSHEV = np.linalg.inv(chebyshev.chebvander(NODES, len(NODES) - 1))[: DEGREE + 1]
"""Matrix from values at the nodes to Chebyshev coefficients up to `DEGREE`; higher ones hold rounding errors."""

_POWERS = np.array([np.pad(chebyshev.cheb2poly(row), (0, DEGREE - k)) for k, row in enumerate(np.eye(DEGREE + 1))])
_SHIFT = [[comb(j, k) * (-1.0) ** (j - k) for j in range(DEGREE + 1)] for k in range(DEGREE + 1)]
TAYLOR = np.array(_SHIFT) @ _POWERS.T
"""Matrix from Chebyshev coefficients to Taylor coefficients about -1, powers of x = u - 1 in powers of u; whole numbers."""


class OwnMotion(Protocol):
    """What a user's class has to offer.

    It may also have ``breakpoints``, the instants within the motion [s] at which its acceleration or a higher derivative jumps, and
    ``coordinates``, "end-effector" (the default) or "joints".
    """

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""

    def position(self, time: float) -> Sequence[float]:
        """Return x and y of the end effector [m], or q11 and q21 of the joints [rad], at a time from 0 to the duration [s]."""


def as_trajectory(motion: OwnMotion | Trajectory) -> Trajectory:
    """Return a motion as a trajectory: itself if it has the members of `Trajectory`, otherwise polynomials through its positions.

    Raises:
        TrajectoryError: something is missing, a position is not two finite numbers, the motion doesn't begin and end at rest, its
            velocity jumps, or it isn't smooth between its breakpoints.
    """
    if isinstance(motion, type):
        raise TrajectoryError(
            f"an own motion is an object of its class: give {motion.__name__}() in place of {motion.__name__}"
        )
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

    samples = sampled(np.linspace(0.0, duration, SAMPLES))
    accuracy = max(ACCURACY * float(np.ptp(samples, axis=0).max()), ROUNDING * float(abs(samples).max()))
    found = [
        piece
        for begin, end in pairwise(points)
        for piece in _pieces(sampled, begin, end, accuracy, SHORTEST * duration)
    ]
    trajectory = PiecewisePolynomial(
        np.array([*(start for start, _ in found), duration]), np.stack([each for _, each in found], axis=1)
    )
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


def _pieces(
    sampled: Callable[[RealArray], RealArray], begin: float, end: float, accuracy: float, shortest: float
) -> list[tuple[float, RealArray]]:
    """Return start [s] and Taylor coefficients (degree + 1, 2) of each polynomial between two times."""
    half = 0.5 * (end - begin)
    values = sampled(begin + half * (1.0 + NODES))
    # relative to the first one, so that rounding gives a standstill no velocity
    first = values[0]
    values = values - first
    # every other node predicts those between them
    error = abs(PREDICTION @ values[::2] - values).max()
    if error <= accuracy:
        # Chebyshev coefficients first: rounding errors of the highest stay as small as these
        coefficients = (TAYLOR @ (CHEBYSHEV @ values)) * half ** -np.arange(DEGREE + 1.0)[:, np.newaxis]
        coefficients[0] += first
        return [(begin, coefficients)]
    middle = begin + half
    if half < shortest:
        raise TrajectoryError(
            f"the own motion isn't smooth near {middle:.6g} s: add this instant to its `breakpoints` if its acceleration or a higher "
            "derivative jumps there; position and velocity must not"
        )
    both = ((begin, middle), (middle, end))
    return [piece for left, right in both for piece in _pieces(sampled, left, right, accuracy, shortest)]


def _check_velocity(motion: PiecewisePolynomial) -> None:
    """Raise TrajectoryError unless the motion begins and ends at rest, without a jump of the velocity between."""
    points = np.array(motion.breakpoints)
    positions, velocities = abs(motion.evaluate(np.linspace(0.0, motion.duration, 1000), 1)).max(axis=(1, 2))
    # rounding errors of the velocity grow with degree² / interval, by Markov's inequality
    rounding = ROUNDING * positions * DEGREE**2 / np.diff(points).min()
    jumps = abs(motion.evaluate(points, 1, "right")[1] - motion.evaluate(points, 1, "left")[1]).max(axis=1)
    worst = int(jumps.argmax())
    if jumps[worst] > max(AT_REST * velocities, rounding):
        raise TrajectoryError(
            f"the velocity of the own motion jumps by {jumps[worst]:.4g} per second at {points[worst]:.6g} s: it must begin and "
            "end at rest, and its velocity must be continuous"
        )
