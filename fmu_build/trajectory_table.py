"""A trajectory as a table: knots so close that polynomials between them reproduce it.

Position, velocity and acceleration are interpolated each by itself, by the polynomial of degree 9 through value and four
derivatives at both knots; so the acceleration is as exact as the position, and nothing is lost by differentiating. At a
breakpoint there are two knots, one for each side.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import comb, factorial
from typing import TYPE_CHECKING

import numpy as np

from flexfmu.fmu_build.errors import ModelError
from flexfmu.trajectories.jets import RealArray

if TYPE_CHECKING:
    from flexfmu.trajectories.trajectory import Trajectory

KINDS = ("position", "velocity", "acceleration")
"""What the FMU outputs: the trajectory and its first two derivatives."""

END_ORDER = 4
"""Derivatives of each of them that a polynomial meets at both knots."""

ORDERS = len(KINDS) + END_ORDER
"""Rows of a knot: the position and its derivatives up to the fourth of the acceleration."""

TOLERANCE = 2e-13
"""Largest difference to the trajectory at the checked points, relative to the largest value of its kind: a fifth of what
is promised, since the checked points are few."""

SHORTEST = 1e-7
"""Knots nearer than this fraction of the duration would resolve rounding errors instead of the trajectory."""

_CHECKED = np.array([0.25, 0.5, 0.75])
"""Where an interval is checked; the error of an interpolant through both ends is largest about the middle."""

_SCALE_POINTS = 200
"""Points per interval between breakpoints from which the largest values are taken."""


@dataclass(frozen=True)
class TrajectoryTable:
    """Knots of a trajectory.

    Attributes:
        times: (K,) [s], ascending; each breakpoint appears twice, but for the first and the last.
        jets: (K, 7, axes) position and derivatives up to order 6: of a pair the left limits, then the right ones.
        errors: largest difference to the trajectory between the knots, of each of `KINDS`, relative to its largest value.
    """

    times: RealArray
    jets: RealArray
    errors: tuple[float, ...]


def tabulate(trajectory: Trajectory, tolerance: float = TOLERANCE) -> TrajectoryTable:
    """Choose knots and check them against the trajectory: intervals that don't keep to the tolerance are halved.

    Raises:
        ModelError: no knots reproduce it, as where a breakpoint is missing.
    """
    points = np.array(trajectory.breakpoints, dtype=np.float64)
    scales = _scales(trajectory, points)
    begins, ends = points[:-1], points[1:]
    accepted: list[tuple[RealArray, RealArray, RealArray]] = []
    # halve the intervals that miss the tolerance until none is left
    while begins.size:
        _refuse_short(trajectory, begins, ends)
        error = _errors(trajectory, begins, ends, _CHECKED) / scales
        good = (error <= tolerance).all(axis=1)
        accepted.append((begins[good], ends[good], error[good]))
        begins, ends = begins[~good], ends[~good]
        middles = 0.5 * (begins + ends)
        begins, ends = np.concatenate([begins, middles]), np.concatenate([middles, ends])
    begins, ends, error = (np.concatenate(parts) for parts in zip(*accepted, strict=True))
    # knots in the order of time
    order = np.argsort(begins)
    return _assemble(trajectory, begins[order], ends[order], points, error.max(axis=0))


def hermite(left: RealArray, right: RealArray, width: RealArray, fraction: float) -> RealArray:
    """Value of the polynomials through value and four derivatives at both ends.

    Args:
        left, right: (5, N, axes) value and derivatives at the ends.
        width: (N,) length of the intervals.
        fraction: where, 0..1 from left to right.
    """
    # Taylor coefficients in the interval's own variable
    scaled = np.array([width**k / factorial(k) for k in range(END_ORDER + 1)])[:, :, None]
    a, b = left * scaled, right * scaled
    # seen from the nearer end, so that rounding errors vanish at both
    if fraction > 0.5:
        signs = np.array([1.0, -1.0, 1.0, -1.0, 1.0])[:, None, None]
        a, b, fraction = signs * b, signs * a, 1.0 - fraction
    # the upper half of the coefficients removes the mismatch at the other end
    known = np.array([[comb(j, i) for j in range(5)] for i in range(5)], dtype=np.float64)
    rest = np.tensordot(np.array(end_matrix(), dtype=np.float64), b - np.tensordot(known, a, axes=1), axes=1)
    powers = fraction ** np.arange(10.0)
    value: RealArray = np.tensordot(powers, np.concatenate([a, rest]), axes=1)
    return value


def end_matrix() -> list[list[int]]:
    """Integer inverse of C(5 + j, i): what the mismatch at the right end makes of the upper half of the coefficients."""
    matrix = np.array([[comb(5 + j, i) for j in range(5)] for i in range(5)], dtype=np.float64)
    inverse: list[list[int]] = np.rint(np.linalg.inv(matrix)).astype(int).tolist()
    return inverse


def _scales(trajectory: Trajectory, points: RealArray) -> RealArray:
    """(3,) largest absolute value of each of `KINDS`; where all is zero, one."""
    times = np.concatenate([np.linspace(a, b, _SCALE_POINTS) for a, b in pairwise(points)])
    largest = abs(trajectory.evaluate(times, len(KINDS) - 1, "right")).max(axis=(1, 2))
    return np.where(largest > 0.0, largest, 1.0)


def _errors(trajectory: Trajectory, begins: RealArray, ends: RealArray, fractions: RealArray) -> RealArray:
    """(N, 3) largest difference between polynomials and trajectory, of each of `KINDS`."""
    left = trajectory.evaluate(begins, ORDERS - 1, "right")
    right = trajectory.evaluate(ends, ORDERS - 1, "left")
    errors = np.zeros((len(begins), len(KINDS)))
    for fraction in fractions.tolist():
        # at each fraction all intervals at once
        width = ends - begins
        exact = trajectory.evaluate(begins + fraction * width, len(KINDS) - 1, "right")
        for kind in range(len(KINDS)):
            rows = slice(kind, kind + END_ORDER + 1)
            found = hermite(left[rows], right[rows], width, fraction)
            errors[:, kind] = np.maximum(errors[:, kind], abs(found - exact[kind]).max(axis=1))
    return errors


def _refuse_short(trajectory: Trajectory, begins: RealArray, ends: RealArray) -> None:
    shortest = int(np.argmin(ends - begins))
    if not ends[shortest] - begins[shortest] > SHORTEST * trajectory.duration:
        raise ModelError(
            f"no table reproduces the trajectory at {ends[shortest]:.6g} s; it has to be smooth to the sixth derivative "
            "between its breakpoints, so name the breakpoint that is missing there"
        )


def _assemble(
    trajectory: Trajectory, begins: RealArray, ends: RealArray, points: RealArray, errors: RealArray
) -> TrajectoryTable:
    """One knot between two intervals, two where a breakpoint is."""
    after_jump = begins[np.isin(begins, points)]
    times = np.concatenate([ends, after_jump])
    limits = [trajectory.evaluate(after_jump, ORDERS - 1, "right"), trajectory.evaluate(ends, ORDERS - 1, "left")]
    order = np.argsort(times, kind="stable")  # of a pair the left limits first
    jets = np.concatenate(limits[::-1], axis=1)[:, order]
    return TrajectoryTable(times[order], np.ascontiguousarray(jets.swapaxes(0, 1)), tuple(errors.tolist()))
