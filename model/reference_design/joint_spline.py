"""Joint references as B-splines in normalised time, which start and end at rest.

Both joints are quintic splines on the same knots with full multiplicity at the ends, uniform or denser near both. The first coefficients are equal, and so
are the last: velocity, acceleration and jerk are zero at both ends. A derivative is a spline whose coefficients are linear in
those of the spline, and bounds on them bound the derivative everywhere (convex hull).

Source: C. de Boor, *A Practical Guide to Splines*, Springer 2001, chapters IX (basis), X (derivatives, convex hull).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.linalg import block_diag

from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.errors import TrajectoryError, positive
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import PiecewisePolynomial
from flexfmu.trajectories.sources import from_scipy
from flexfmu.trajectories.trajectory import Trajectory

DEGREE = 5
"""Degree of the splines: the jerk is continuous."""

REST = 4
"""Equal coefficients at each end: velocity, acceleration and jerk are zero there."""


class DesignedMotion(Protocol):
    """A motion of the joints from rest to rest, with m variables that a design may change; the last one is its duration."""

    @property
    def duration(self) -> float:
        """Duration T [s]."""

    @property
    def intervals(self) -> int:
        """Number of equal parts of the duration that steps of an integration go with."""

    @property
    def variables(self) -> RealArray:
        """What a design may change (m,)."""

    @property
    def room(self) -> RealArray:
        """Largest changes of the variables, down and up (2, m)."""

    def with_duration(self, duration: float) -> Self:
        """Return the motion with another duration."""

    def moved(self, change: RealArray) -> Self:
        """Return the motion after a change of its variables (m,)."""

    def evaluate(self, fraction: ArrayLike, order: int = 2) -> RealArray:
        """Return joint angles and their time derivatives at fractions of the duration, (order + 1, N, 2) [rad, rad/s, ...]."""

    def derivatives(self, fractions: RealArray) -> RealArray:
        """Return derivatives (N, 6, m) of [q_a, v_a, a_a] at fractions of the duration by the variables."""

    def rates(self, fractions: RealArray, references: RealArray, by: RealArray) -> list[tuple[RealArray, RealArray]]:
        """Return values whose bounds bound speeds, accelerations and jerks, three of (n, 2), and their derivatives (n, 2, m).

        Args:
            fractions: of the duration (N,).
            references: angles, speeds and accelerations there (3, N, 2).
            by: derivatives of these (N, 6, m); m is 0 where none are wanted.
        """

    def conditions(self) -> tuple[RealArray, RealArray]:
        """Return values (c,) that must not be positive for a motion to exist, and their derivatives (c, m)."""

    def measures(self, unit: float) -> tuple[RealArray, RealArray]:
        """Return the size (m,) of changes that count alike, for a usual duration [s], and the squared size (m, m) of changes of the
        acceleration, relative to the largest one, and of the duration."""


@dataclass(frozen=True, eq=False)
class JointSpline:
    """Joint angles as B-splines in normalised time, both with the same knots.

    As a design its variables are [free coefficients of joint 1, of joint 2, T].

    Attributes:
        coefficients: of the basis functions [rad], shape (n, 2); n is the number of intervals + `DEGREE`.
        duration: duration of the motion [s].
        crowding: how much denser knots are near both ends, see `spline_knots`.

    Raises:
        TrajectoryError: the duration isn't positive, or the coefficients have a wrong shape.
    """

    coefficients: RealArray
    duration: float
    crowding: float = 0.0

    def __post_init__(self) -> None:
        positive("trajectory duration", self.duration, "s")
        shape = self.coefficients.shape
        if len(shape) != 2 or shape[1] != 2 or shape[0] < 2 * REST:
            raise TrajectoryError(f"a joint spline has coefficients of shape ({2 * REST} or more, 2), got {shape}")

    @property
    def intervals(self) -> int:
        """Number of intervals between knots."""
        return len(self.coefficients) - DEGREE

    def with_duration(self, duration: float) -> JointSpline:
        """Return the same motion, faster or slower."""
        return replace(self, duration=duration)

    def evaluate(self, fraction: ArrayLike, order: int = 2) -> RealArray:
        """Return joint angles and their time derivatives, shape (order + 1, N, 2) [rad, rad/s, ...].

        Args:
            fraction: times as fractions of the duration, 0 to 1, shape (N,).
            order: order of the highest derivative.
        """
        points = np.atleast_1d(np.asarray(fraction, dtype=float))
        bases = (basis(self.intervals, points, k, self.crowding) for k in range(order + 1))
        return np.array([each @ self.coefficients / self.duration**k for k, each in enumerate(bases)])

    @property
    def variables(self) -> RealArray:
        """Free coefficients of joint 1, of joint 2, and T."""
        return np.append(self.coefficients[REST:-REST].T, self.duration)

    @property
    def room(self) -> RealArray:
        """Largest changes of the variables: any."""
        return np.outer([-np.inf, np.inf], np.ones(len(self.variables)))

    def moved(self, change: RealArray) -> JointSpline:
        """Return the motion after a change of its variables (m,)."""
        coefficients = self.coefficients.copy()
        coefficients[REST:-REST] += change[:-1].reshape(2, -1).T
        return replace(self, coefficients=coefficients, duration=self.duration + float(change[-1]))

    def derivatives(self, fractions: RealArray) -> RealArray:
        """Return derivatives (N, 6, m) of [q_a, v_a, a_a] at fractions of the duration by the variables."""
        by = np.zeros((len(fractions), 3, 2, len(self.variables)))
        for k, values in enumerate(self.evaluate(fractions)):
            moved = basis(self.intervals, fractions, k, self.crowding)[:, REST:-REST] / self.duration**k
            by[:, k, 0, : moved.shape[1]] = by[:, k, 1, moved.shape[1] : -1] = moved
            by[:, k, :, -1] = -k / self.duration * values
        return by.reshape(len(fractions), 6, -1)

    def rates(self, fractions: RealArray, references: RealArray, by: RealArray) -> list[tuple[RealArray, RealArray]]:
        """Return the coefficients of speeds, accelerations and jerks (n, 2), and their derivatives (n, 2, m); first and last ones are zero."""
        found = []
        for k in (1, 2, 3):
            # the coefficients that aren't zero at rest
            derived = derivative_matrix(self.intervals, k, self.crowding)[REST - k : k - REST]
            value, by_free = derived @ self.coefficients / self.duration**k, derived[:, REST:-REST] / self.duration**k
            own = np.stack([np.kron(unit, by_free) for unit in np.eye(2)], axis=1)
            found.append((value, np.concatenate([own, -k * value[..., np.newaxis] / self.duration], axis=2)))
        return found

    def conditions(self) -> tuple[RealArray, RealArray]:
        """Return no conditions: a motion exists with any coefficients."""
        return np.zeros(0), np.zeros((0, len(self.variables)))

    def measures(self, unit: float) -> tuple[RealArray, RealArray]:
        """Return the size (m,) of changes that count alike, the swing of the joints and a usual duration [s], and the squared size (m, m) of
        changes of the acceleration, relative to the largest one, and of the duration."""
        swing = float(np.ptp(self.coefficients, axis=0).max())
        curve = derivative_matrix(self.intervals, 2, self.crowding)
        by_free = curve[:, REST:-REST]
        metric = np.kron(np.eye(2), by_free.T @ by_free) / np.abs(curve @ self.coefficients).max() ** 2
        return np.append(np.full(len(metric), swing), unit), block_diag(metric, [0.1 * len(curve) / unit**2])

    def trajectory(self) -> PiecewisePolynomial:
        """Return the joints' motion in time, exactly."""
        knots = self.duration * spline_knots(self.intervals, self.crowding)
        return from_scipy(BSpline(knots, self.coefficients, DEGREE), "joints")


def spline_knots(intervals: int, crowding: float = 0.0) -> RealArray:
    """Knots from 0 to 1, the ends with full multiplicity, shape (intervals + 1 + 2 `DEGREE`,).

    With a crowding c below 1 intervals are 1 - c times as long as uniform ones at both ends, and 1 + c times in the middle.
    """
    uniform = np.linspace(0.0, 1.0, intervals + 1)
    inner = uniform - crowding * np.sin(2.0 * np.pi * uniform) / (2.0 * np.pi)
    return np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])


@lru_cache(maxsize=64)
def _basis_splines(intervals: int, order: int, crowding: float) -> BSpline:
    """All basis functions as one spline, or a derivative of them in normalised time, up to the fifth."""
    knots = spline_knots(intervals, crowding)
    return BSpline(knots, np.eye(intervals + DEGREE), DEGREE).derivative(order)


def basis(intervals: int, points: RealArray, order: int = 0, crowding: float = 0.0) -> RealArray:
    """Return a derivative of all basis functions in normalised time at points (N,) of 0 to 1, shape (N, n)."""
    return np.asarray(_basis_splines(intervals, order, crowding)(points))


def derivative_matrix(intervals: int, order: int, crowding: float = 0.0) -> RealArray:
    """Return the matrix from coefficients to those of a derivative in normalised time, shape (n - order, n)."""
    return np.asarray(_basis_splines(intervals, order, crowding).c[: intervals + DEGREE - order])


def rest_matrix(count: int) -> RealArray:
    """Return the matrix from free coefficients and the two end values to all, for motions that start and end at rest.

    Args:
        count: number n of coefficients.

    Returns:
        Shape (n, n - 2 REST + 2); the columns belong to the start value, the free coefficients in order, and the end value.
    """
    columns = np.clip(np.arange(count) - (REST - 1), 0, count - 2 * REST + 1)
    return np.eye(count - 2 * REST + 2)[columns]


def fitted(trajectory: Trajectory, intervals: int, side: Side = "right", crowding: float = 0.0) -> JointSpline:
    """Return the spline next to a motion of the joints by least squares; it has the same ends and starts and ends at rest.

    Args:
        trajectory: motion of the joints [rad]; it may be a shaped one.
        intervals: number of intervals between knots of the spline.
        side: the limit that counts at breakpoints.
        crowding: how much denser the knots are near both ends.
    """
    # points at the nodes of Gauss in every interval
    nodes = np.polynomial.legendre.leggauss(DEGREE + 1)[0]
    knots = spline_knots(intervals, crowding)[DEGREE : DEGREE + intervals + 1]
    points = (knots[:-1, np.newaxis] + np.diff(knots)[:, np.newaxis] * (0.5 + 0.5 * nodes)).ravel()
    duration = trajectory.duration
    angles = trajectory.evaluate(points * duration, 0, side)[0]
    ends = trajectory.evaluate([0.0, duration], 0, "right")[0]
    # the free coefficients
    rest = rest_matrix(intervals + DEGREE)
    matrix = basis(intervals, points, crowding=crowding) @ rest
    free = np.linalg.lstsq(matrix[:, 1:-1], angles - matrix[:, [0, -1]] @ ends, rcond=None)[0]
    return JointSpline(rest @ np.vstack([ends[:1], free, ends[1:]]), duration, crowding)
