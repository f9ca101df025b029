"""Piecewise polynomials in time, and splines through positions with or without derivatives.

Every piece has an odd degree 2 r + 1: values and derivatives up to order r at both its ends determine it. Where only derivatives
up to order m < r are given, the others follow from continuity: at each inner knot the derivatives r + 1 to 2 r - m are
continuous too. So a spline of degree k through derivatives up to order m is k - 1 - m times continuously differentiable: a
quintic one 4 times through positions, 3 times with velocities, twice with accelerations.

Source: C. de Boor, *A Practical Guide to Splines*, Springer 2001, chapters IV (Hermite form) and V (end conditions).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from math import comb, factorial
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.trajectories.errors import TrajectoryError, positive, times
from flexfmu.trajectories.jets import Jet, RealArray, checked_order
from flexfmu.trajectories.trajectory import SAME_TIME, HasLimits

Coordinates: TypeAlias = Literal["end-effector", "joints"]

DEGREES = (3, 5, 7)
"""Degrees of splines."""

ROUNDING = 1e-12
"""Jump of a derivative at a knot, relative to the largest term of its sum, below which it counts as rounding."""


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial(HasLimits):
    """A motion of two coordinates that is a polynomial in time between knots; standstill before the first and after the last.

    Attributes:
        knots: times [s], ascending from 0, shape (K + 1,).
        coefficients: Taylor coefficients about the start of each piece, of the powers 0 to the degree, (degree + 1, K, 2).
        coordinates: what moves: "end-effector" for x, y [m], or "joints" for q11, q21 [rad].

    Raises:
        TrajectoryError: the knots don't ascend from 0, or the shapes don't match.
    """

    knots: RealArray
    coefficients: RealArray
    coordinates: Coordinates = "end-effector"

    def __post_init__(self) -> None:
        knots, shape = self.knots, self.coefficients.shape
        if knots.ndim != 1 or len(knots) < 2 or knots[0] != 0.0 or not bool((np.diff(knots) > 0.0).all()):
            raise TrajectoryError("the knots of a piecewise polynomial must ascend from 0 s, and be 2 or more")
        if len(shape) != 3 or shape[1:] != (len(knots) - 1, 2):
            raise TrajectoryError(
                f"{len(knots)} knots need coefficients of shape (degree + 1, {len(knots) - 1}, 2), got {shape}"
            )

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.knots[-1])

    @property
    def degree(self) -> int:
        """Degree of the pieces."""
        return len(self.coefficients) - 1

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] of the knots at which a derivative jumps, and of start and end."""
        widths = np.diff(self.knots)[:-1, np.newaxis]
        before, after = self.coefficients[:, :-1], self.coefficients[:, 1:]
        jumps = np.zeros(len(self.knots) - 2, dtype=bool)
        # each derivative at the end of a piece against that at the start of the next
        for k in range(1, self.degree + 1):
            terms = [comb(j, k) * before[j] * widths ** (j - k) for j in range(k, self.degree + 1)]
            largest = np.maximum(np.max(np.abs(terms), axis=0), abs(after[k]))
            jumps |= (abs(sum(terms) - after[k]) > ROUNDING * largest).any(axis=1)
        return tuple(self.knots[[0, *(np.flatnonzero(jumps) + 1), -1]].tolist())

    def with_duration(self, duration: float) -> PiecewisePolynomial:
        """Return the same motion, faster or slower.

        Raises:
            TrajectoryError: the duration is not finite or not positive.
        """
        time_scale = self.duration / positive("trajectory duration", duration, "s")
        if time_scale == 1.0:
            return self
        knots = self.knots / time_scale
        knots[-1] = duration
        return replace(self, knots=knots, coefficients=Jet(self.coefficients).rescale(time_scale).coefficients)

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `flexfmu.trajectories.trajectory.HasLimits`."""
        time, order = times(time), checked_order(order)
        # the piece of each time: -1 before the motion, the number of pieces after it
        near, count = SAME_TIME * self.duration, len(self.knots) - 1
        index = np.searchsorted(self.knots, time + np.where(left, -near, near), side="right") - 1
        piece = index.clip(0, count - 1)
        within = time.clip(0.0, self.duration) - self.knots[piece]
        taylor = moved(self.coefficients[:, piece], within[:, np.newaxis])
        # derivatives above the degree are zero, as are all at standstill
        result = np.zeros((order + 1, len(time), 2))
        rows = min(order, self.degree) + 1
        result[:rows] = Jet(taylor[:rows]).derivatives()
        still = (index < 0) | (index == count)
        result[1:, still] = 0.0
        return result

    @property
    def rest(self) -> RealArray:
        """Coordinates at start and end, shape (2, 2)."""
        return np.asarray(self.evaluate([0.0, self.duration], 0, "right")[0])


def moved(coefficients: RealArray, distance: RealArray) -> RealArray:
    """Return the Taylor coefficients (degree + 1, N, 2) about points that are further by ``distance`` (N, 1)."""
    # repeated synthetic division
    found = coefficients.copy()
    for k in range(len(found) - 1):
        for j in range(len(found) - 2, k - 1, -1):
            found[j] += distance * found[j + 1]
    return found


def spline(
    time: ArrayLike, derivatives: ArrayLike, degree: int = 5, coordinates: Coordinates = "end-effector"
) -> PiecewisePolynomial:
    """Return the spline through positions and given derivatives; it is ``degree`` - 1 - m times continuously differentiable.

    The derivatives that aren't given are zero at start and end: the motion starts and ends at rest.

    Args:
        time: times [s], shape (N,), not descending. The first one is the start of the motion. A time that appears twice is a
            jump of the highest derivatives: first their left limits, then the right ones.
        derivatives: coordinates and their derivatives up to order m at these times, shape (m + 1, N, 2).
        degree: 3, 5 or 7, at least 2 m + 1.
        coordinates: what moves.

    Raises:
        TrajectoryError: the degree is another or too low, or the shapes don't match.
    """
    t, given = np.asarray(time, dtype=float), np.asarray(derivatives, dtype=float)
    if given.ndim != 3 or given.shape[1:] != (len(t), 2) or len(t) < 2:
        raise TrajectoryError(
            f"a spline needs derivatives of shape (m + 1, {len(t)}, 2) at 2 or more times, got {given.shape}"
        )
    if degree not in DEGREES or degree < 2 * len(given) - 1:
        raise TrajectoryError(
            f"derivatives up to order {len(given) - 1} need a spline of degree {listed_degrees(len(given) - 1)}, got {degree}"
        )
    half = degree // 2 + 1
    known = np.zeros((half, len(t), 2))
    known[: len(given)] = given
    # derivatives that aren't given, between jumps
    jumps = np.flatnonzero(np.diff(t) == 0.0) + 1
    for first, last in pairwise([0, *jumps, len(t)]):
        if len(given) < half and last - first > 2:
            known[len(given) :, first:last] = _missing(t[first:last], known[:, first:last], len(given))
    begins = np.flatnonzero(np.diff(t) > 0.0)
    widths = np.diff(t)[begins]
    pieces = _pieces(widths, known[:, begins], known[:, begins + 1])
    return PiecewisePolynomial(np.concatenate([t[begins], t[-1:]]) - t[0], pieces, coordinates)


def listed_degrees(order: int) -> str:
    """Degrees that splines through derivatives up to ``order`` may have, as text."""
    return " or ".join(str(degree) for degree in DEGREES if degree >= 2 * order + 1)


def _pieces(widths: RealArray, left: RealArray, right: RealArray) -> RealArray:
    """Taylor coefficients (2 r + 2, K, 2) of pieces of lengths (K,) through derivatives (r + 1, K, 2) at both ends."""
    half = len(left)
    powers = widths ** np.arange(2 * half)[:, np.newaxis]
    factorials = np.array([float(factorial(k)) for k in range(half)])[:, np.newaxis]
    scale = (powers[:half] / factorials)[:, :, np.newaxis]
    lower = left * scale
    upper = np.tensordot(_end_matrix(half), right * scale - np.tensordot(_shift(half), lower, 1), 1)
    return np.asarray(np.concatenate([lower, upper]) / powers[:, :, np.newaxis])


def _shift(half: int) -> RealArray:
    """C(j, i): derivatives at 1 that the lower coefficients (j) give, divided by factorials (i)."""
    return np.array([[float(comb(j, i)) for j in range(half)] for i in range(half)])


def _end_matrix(half: int) -> RealArray:
    """Map from the rest of the derivatives at 1, divided by factorials, to the upper coefficients; integers."""
    upper = np.array([[float(comb(half + j, i)) for j in range(half)] for i in range(half)])
    return np.rint(np.linalg.inv(upper))


def _missing(t: RealArray, known: RealArray, given: int) -> RealArray:
    """Return the derivatives of orders ``given`` to r from continuity of those above r, (r + 1 - given, N, 2).

    Args:
        t: times of the knots [s], (N,), ascending.
        known: derivatives (r + 1, N, 2): of orders below ``given`` at all knots, of the others at both ends.
        given: number of derivatives that are known at all knots.
    """
    from scipy.linalg import solve_banded  # here, since other motions need no scipy

    # in units of the median step, divided by factorials
    half, knots = len(known), len(t)
    count, unit = half - given, float(np.median(np.diff(t)))
    scale = (unit ** np.arange(half) / [float(factorial(k)) for k in range(half)])[:, np.newaxis, np.newaxis]
    scaled, widths = known * scale, np.diff(t) / unit
    # coefficients above r about the start of a piece of length 1, from derivatives at its start and its end
    end = _end_matrix(half)
    of_start, of_end = -(end @ _shift(half)), end
    # at each inner knot, coefficient ``order`` of the piece after it minus that of the piece before it, backwards in time
    inner = np.arange(1, knots - 1)
    band, size = 2 * count - 1, count * (knots - 2)
    matrix, right_side = np.zeros((2 * band + 1, size)), np.zeros((size, 2))
    for row, k in product(range(count), range(half)):
        order, equation = half + row, count * (inner - 1) + row
        after, before = widths[inner] ** (k - order), (-1.0) ** (k + order) * widths[inner - 1] ** (k - order)
        factors = {0: of_start[row, k] * (after - before), 1: of_end[row, k] * after, -1: -of_end[row, k] * before}
        for offset, factor in factors.items():
            knot = inner + offset
            free = (knot > 0) & (knot < knots - 1) & (k >= given)
            right_side[equation[~free]] -= factor[~free, np.newaxis] * scaled[k, knot[~free]]
            column = (count * (knot - 1) + k - given)[free]
            matrix[band + equation[free] - column, column] = factor[free]
    scaled[given:, 1:-1] = solve_banded((band, band), matrix, right_side).reshape(knots - 2, count, 2).swapaxes(0, 1)
    return np.asarray((scaled / scale)[given:])
