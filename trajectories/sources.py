"""Trajectories of other libraries as ours, piece by piece: ruckig, toppra, and splines of scipy.

All three give polynomials between knots, which are taken as they are: nothing is sampled, and where a derivative jumps is a
breakpoint. A motion of the robot has two coordinates, and starts and ends at rest.

Sources: L. Berscheid, T. Kröger, Jerk-limited real-time trajectory generation with arbitrary target states, RSS 2021 (ruckig);
H. Pham, Q.-C. Pham, A new approach to time-optimal path parameterization based on reachability analysis, IEEE Trans. Robot.
34 (2018) (toppra).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import Jet, RealArray, compose
from flexfmu.trajectories.piecewise import Coordinates, PiecewisePolynomial, moved
from flexfmu.trajectories.trajectory import SAME_TIME, merged

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
    """Return the motion that a toppra algorithm's `compute_trajectory` gives, of either parametrizer.

    `ParametrizeSpline` gives a cubic spline. `ParametrizeConstAccel` gives a path's cubic spline after quadratic polynomials of
    time: degree 6, between grid points and the path's knots.

    Args:
        trajectory: the motion.
        coordinates: what moves, as for `from_scipy`.

    Raises:
        TrajectoryError: it is something else, hasn't two degrees of freedom, or its path isn't a spline.
    """
    if trajectory is None:
        raise TrajectoryError("toppra found no trajectory: relax its limits, or move the path")
    if hasattr(trajectory, "cspl"):
        return from_scipy(trajectory.cspl, coordinates)
    path = getattr(getattr(trajectory, "_path", None), "cspl", None)
    if path is None:
        raise TrajectoryError(
            f"expected what toppra's compute_trajectory returns for a SplineInterpolator, got {type(trajectory).__name__}: "
            'for other paths choose parametrizer="ParametrizeSpline"'
        )
    pieces, grid, speeds = _pieces_of(path), np.asarray(trajectory._ss), np.asarray(trajectory._velocities)
    _check_axes(pieces.taylor.shape[2])
    # time between grid points, at constant acceleration along the path
    widths, taylor = list[float](), list[RealArray]()
    for (s, end), (speed, last) in zip(pairwise(grid.tolist()), pairwise(speeds.tolist()), strict=True):
        acceleration = 0.5 * (last**2 - speed**2) / (end - s)
        inside = pieces.starts[(pieces.starts > s) & (pieces.starts < end)].tolist()
        for a, b in pairwise(merged([s, end], inside, SAME_TIME * float(grid[-1] - grid[0]))):
            # speeds at both ends of a part of one path piece
            v, w = (max(speed**2 + 2.0 * acceleration * (each - s), 0.0) ** 0.5 for each in (a, b))
            inner = np.zeros((7, 1))
            inner[:3, 0] = a, v, 0.5 * acceleration
            outer = np.zeros((7, AXES, 1))
            here = pieces.about(np.array([a]), np.array([0.5 * (a + b)]))
            outer[: len(here), :, 0] = here[:, 0]
            widths.append(2.0 * (b - a) / (v + w))
            taylor.append(compose(Jet(outer), Jet(inner)).coefficients[:, :, 0])
    return PiecewisePolynomial(np.concatenate([[0.0], np.cumsum(widths)]), np.stack(taylor, axis=1), coordinates)


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
