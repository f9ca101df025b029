"""A trajectory as a table of knots, from which polynomials reproduce it.

Position, velocity and acceleration are interpolated separately, by the Hermite polynomial of degree 9 through value and four
derivatives at both knots; so the acceleration is as accurate as the position. A breakpoint has two knots, one for each limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import comb, factorial

import numpy as np

from flexfmu.fmu_build.errors import ModelError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import Trajectory

KINDS = ("position", "velocity", "acceleration")
"""Outputs of the FMU: the trajectory and its first two derivatives."""

END_ORDER = 4
"""Number of derivatives of each of `KINDS` that a polynomial interpolates at both knots."""

ORDERS = len(KINDS) + END_ORDER
"""Rows of a knot: the position and its derivatives up to order 6."""

TOLERANCE = 2e-13
"""Largest error at the checked points, relative to the largest value of each of `KINDS`; a fifth of the documented
accuracy, since few points are checked."""

SHORTEST = 1e-7
"""Shortest interval between knots as a fraction of the duration; shorter ones would resolve rounding errors."""

_CHECKED = (0.25, 0.5, 0.75)
"""Fractions of an interval at which it is checked; the interpolation error is largest near the middle."""

_SCALE_POINTS = 200
"""Points per interval between breakpoints that are searched for the largest values."""


@dataclass(frozen=True)
class TrajectoryTable:
    """Knots of a trajectory.

    Attributes:
        times: (K,) [s], ascending; each breakpoint appears twice, except the first and the last.
        jets: (K, 7, axes) position and derivatives up to order 6; at a breakpoint the left limits, then the right ones.
        errors: largest error between the knots of each of `KINDS`, relative to its largest value.
    """

    times: RealArray
    jets: RealArray
    errors: tuple[float, ...]


def tabulate(trajectory: Trajectory, tolerance: float = TOLERANCE) -> TrajectoryTable:
    """Tabulate a trajectory; intervals whose error exceeds the tolerance are halved.

    Raises:
        ModelError: no knots reproduce the trajectory, for example because a breakpoint is missing.
    """
    points = np.array(trajectory.breakpoints, dtype=np.float64)
    # largest values of each of `KINDS`; 1 where all are zero
    dense = np.concatenate([np.linspace(a, b, _SCALE_POINTS) for a, b in pairwise(points)])
    largest = abs(trajectory.evaluate(dense, len(KINDS) - 1, "right")).max(axis=(1, 2))
    scales = np.where(largest > 0.0, largest, 1.0)
    begins, ends = points[:-1], points[1:]
    accepted: list[tuple[RealArray, RealArray, RealArray]] = []
    # halve the intervals that miss the tolerance until none is left
    while begins.size:
        shortest = int(np.argmin(ends - begins))
        if not ends[shortest] - begins[shortest] > SHORTEST * trajectory.duration:
            raise ModelError(
                f"no table reproduces the trajectory at {ends[shortest]:.6g} s; it has to be smooth to the sixth derivative "
                "between its breakpoints, so name the breakpoint that is missing there"
            )
        error = _errors(trajectory, begins, ends) / scales
        good = (error <= tolerance).all(axis=1)
        accepted.append((begins[good], ends[good], error[good]))
        begins, ends = begins[~good], ends[~good]
        middles = 0.5 * (begins + ends)
        begins, ends = np.concatenate([begins, middles]), np.concatenate([middles, ends])
    begins, ends, error = (np.concatenate(parts) for parts in zip(*accepted, strict=True))
    # knots sorted by time: one between two intervals, or two at a breakpoint, left limits first
    sorted_ = np.argsort(begins)
    begins, ends = begins[sorted_], ends[sorted_]
    after_jump = begins[np.isin(begins, points)]
    times = np.concatenate([ends, after_jump])
    limits = [trajectory.evaluate(ends, ORDERS - 1, "left"), trajectory.evaluate(after_jump, ORDERS - 1, "right")]
    order = np.argsort(times, kind="stable")
    jets = np.concatenate(limits, axis=1)[:, order]
    errors = tuple(error.max(axis=0).tolist())
    return TrajectoryTable(times[order], np.ascontiguousarray(jets.swapaxes(0, 1)), errors)


def hermite(left: RealArray, right: RealArray, width: RealArray, fraction: float) -> RealArray:
    """Values, shape (N, axes), of the Hermite polynomials through value and four derivatives at both ends.

    Args:
        left, right: (5, N, axes) value and derivatives at the ends.
        width: (N,) lengths of the intervals [s].
        fraction: position in the intervals, 0..1 from left to right.
    """
    # Taylor coefficients in the normalised variable 0..1
    scaled = np.array([width**k / factorial(k) for k in range(END_ORDER + 1)])[:, :, None]
    a, b = left * scaled, right * scaled
    # expand about the nearer end, so that rounding errors vanish at both
    if fraction > 0.5:
        signs = np.array([1.0, -1.0, 1.0, -1.0, 1.0])[:, None, None]
        a, b, fraction = signs * b, signs * a, 1.0 - fraction
    # the upper half of the coefficients satisfies the conditions at the other end
    known = np.array([[comb(j, i) for j in range(5)] for i in range(5)], dtype=np.float64)
    rest = np.tensordot(np.array(end_matrix(), dtype=np.float64), b - np.tensordot(known, a, axes=1), axes=1)
    powers = fraction ** np.arange(10.0)
    value: RealArray = np.tensordot(powers, np.concatenate([a, rest]), axes=1)
    return value


def end_matrix() -> list[list[int]]:
    """Inverse of the matrix C(5 + j, i), integers: maps the residual at the right end to the upper five coefficients."""
    matrix = np.array([[comb(5 + j, i) for j in range(5)] for i in range(5)], dtype=np.float64)
    inverse: list[list[int]] = np.rint(np.linalg.inv(matrix)).astype(int).tolist()
    return inverse


def _errors(trajectory: Trajectory, begins: RealArray, ends: RealArray) -> RealArray:
    """Largest error of the polynomials in each interval, for each of `KINDS`, shape (N, 3)."""
    left = trajectory.evaluate(begins, ORDERS - 1, "right")
    right = trajectory.evaluate(ends, ORDERS - 1, "left")
    errors = np.zeros((len(begins), len(KINDS)))
    for fraction in _CHECKED:
        # all intervals at once
        width = ends - begins
        exact = trajectory.evaluate(begins + fraction * width, len(KINDS) - 1, "right")
        for kind in range(len(KINDS)):
            rows = slice(kind, kind + END_ORDER + 1)
            found = hermite(left[rows], right[rows], width, fraction)
            errors[:, kind] = np.maximum(errors[:, kind], abs(found - exact[kind]).max(axis=1))
    return errors
