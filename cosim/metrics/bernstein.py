"""Polynomials in Bernstein form on many segments at once: evaluation, bounds, maxima.

A polynomial on [0, 1] lies in the convex hull of its control points, which therefore bound it. Bisecting the interval
reduces their distance from the polynomial by a factor of four (G. Farin, *Curves and Surfaces for CAGD*, chapters 5 and
6).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from flexfmu.cosim.engine.slave import RealArray

PEAK_TOLERANCE = 1e-11
"""Relative gap at which the search for a maximum stops: far above rounding errors, far below any metric's error."""

MAXIMUM_BISECTIONS = 60
"""Bisections after which a segment is as short as the spacing of floating-point numbers."""


def bernstein_basis(theta: RealArray, degree: int) -> RealArray:
    """Return the Bernstein polynomials (k, degree + 1) at ``theta`` (k,)."""
    order = np.arange(degree + 1)
    binomial = np.array([math.comb(degree, int(i)) for i in order], dtype=float)
    column = np.asarray(theta, dtype=float)[:, np.newaxis]
    return np.asarray(binomial * column**order * (1.0 - column) ** (degree - order))


@cache
def gauss_legendre(count: int) -> tuple[RealArray, RealArray]:
    """Return points and weights of Gauss-Legendre quadrature on [0, 1], exact to degree 2 count - 1."""
    points, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * (points + 1.0), 0.5 * weights


def maximum_norm(control: RealArray) -> float:
    """Return the largest norm on [0, 1] of polynomials with Bernstein control points (degree + 1, n, c).

    Bisects the segments whose bound, the control points, exceeds the largest value found so far; every bisection
    reduces the gap between bound and value by a factor of four. The result is NaN if a control point is NaN.
    """
    if control.shape[1] == 0:
        return 0.0
    best = 0.0
    for _ in range(MAXIMUM_BISECTIONS):
        # the end control points are values of the polynomial, the others are bounds
        norms = np.linalg.norm(control, axis=2)
        if np.any(np.isnan(norms)):
            return math.nan
        best = max(best, float(norms[0].max()), float(norms[-1].max()))
        # bisect only segments that may exceed the largest value
        open_segments = norms.max(axis=0) > best * (1.0 + PEAK_TOLERANCE)
        if not np.any(open_segments):
            break
        control = np.concatenate(bisect(control[:, open_segments]), axis=1)
    return best


def bisect(control: RealArray) -> tuple[RealArray, RealArray]:
    """Return the control points (degree + 1, n, c) of both halves of every segment, by de Casteljau's algorithm."""
    first, second, level = np.empty_like(control), np.empty_like(control), control
    for i in range(len(control)):
        # the ends of each level of averages are control points of the halves
        first[i], second[-1 - i] = level[0], level[-1]
        level = 0.5 * (level[:-1] + level[1:])
    return first, second


def hermite_control_points(derivatives: RealArray, duration: RealArray) -> RealArray:
    """Return the m control points (m, n, c) next to a segment's end with these derivatives of order 0..m-1 (m, n, c).

    ``duration`` (n,) [s] is the length of each segment, negative for derivatives at its right end; the points of a
    right end are in reverse order.
    """
    m = len(derivatives)
    degree = 2 * m - 1
    scale = [math.factorial(degree - i) / math.factorial(degree) * duration**i for i in range(m)]
    scaled = derivatives * np.stack(scale)[:, :, np.newaxis]
    binomials = np.array([[math.comb(j, i) for i in range(m)] for j in range(m)], dtype=float)
    return np.asarray(np.einsum("ji,inc->jnc", binomials, scaled))


def last_time_above(control: RealArray, start: RealArray, duration: RealArray, level: float) -> float | None:
    """Return the last time at which the norm of the polynomials is at least ``level``; None if it is below throughout.

    Args:
        control: (degree + 1, n, c) control points of n consecutive segments.
        start, duration: (n,) start and length of each segment.
        level: zero or positive, in the unit of ``control``.
    """
    reach = np.linalg.norm(control, axis=2).max(axis=0)
    for index in np.flatnonzero(reach >= level)[::-1]:
        theta = _last_theta_above(control[:, index : index + 1], level)
        if theta is not None:
            return float(start[index] + theta * duration[index])
    return None


def _last_theta_above(control: RealArray, level: float) -> float | None:
    """Return the last such normalised time in one segment, by bisection; None if the norm is below throughout."""
    # search halves from the right, drop those whose bound is below the level
    pieces = [(control, 0.0, 1.0)]
    while pieces:
        piece, left, right = pieces.pop()
        norms = np.linalg.norm(piece[:, 0], axis=1)
        if norms.max() < level:
            continue
        middle = 0.5 * (left + right)
        if norms[-1] >= level or not left < middle < right:
            return right
        first, second = bisect(piece)
        pieces += [(first, left, middle), (second, middle, right)]
    return None
