"""Polynomials in Bernstein form on many segments at once: evaluation, bounds, maxima.

G. Farin, *Curves and Surfaces for CAGD*, chapters 5 and 6. A polynomial on [0, 1] lies in the convex hull of its control
points, so they bound it, and halving the interval brings them closer to it by a factor of four.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from flexfmu.cosim.engine.slave import RealArray

PEAK_TOLERANCE = 1e-11
"""Relative gap at which the search for a maximum stops: far above rounding, far below any metric's own error."""

MAXIMUM_BISECTIONS = 60
"""Bisections after which a segment has shrunk to the spacing of floating-point numbers."""


def bernstein_basis(theta: RealArray, degree: int) -> RealArray:
    """(k, degree + 1) Bernstein polynomials at ``theta`` (k,)."""
    order = np.arange(degree + 1)
    binomial = np.array([math.comb(degree, int(i)) for i in order], dtype=float)
    column = np.asarray(theta, dtype=float)[:, np.newaxis]
    return np.asarray(binomial * column**order * (1.0 - column) ** (degree - order))


@cache
def gauss_legendre(count: int) -> tuple[RealArray, RealArray]:
    """Points and weights of Gauss quadrature on [0, 1], exact to degree 2 count - 1."""
    points, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * (points + 1.0), 0.5 * weights


def maximum_norm(control: RealArray) -> float:
    """Largest norm of polynomials with the Bernstein control points ``control`` (degree + 1, n, c) on [0, 1].

    Bisects the segments whose control points, which bound the polynomial, reach further than the largest value seen so
    far; the gap between bound and value shrinks fourfold with every bisection. NaN among the control points is the
    result NaN.
    """
    if control.shape[1] == 0:
        return 0.0
    best = 0.0
    for _ in range(MAXIMUM_BISECTIONS):
        # the ends of a segment are values, its other control points are bounds
        norms = np.linalg.norm(control, axis=2)
        if np.any(np.isnan(norms)):
            return math.nan
        best = max(best, float(norms[0].max()), float(norms[-1].max()))
        # only segments that may reach further are halved
        open_segments = norms.max(axis=0) > best * (1.0 + PEAK_TOLERANCE)
        if not np.any(open_segments):
            break
        control = np.concatenate(bisect(control[:, open_segments]), axis=1)
    return best


def bisect(control: RealArray) -> tuple[RealArray, RealArray]:
    """Control points (degree + 1, n, c) of the two halves of every segment (de Casteljau's algorithm)."""
    first, second, level = np.empty_like(control), np.empty_like(control), control
    for i in range(len(control)):
        # each level of averages ends in a control point of either half
        first[i], second[-1 - i] = level[0], level[-1]
        level = 0.5 * (level[:-1] + level[1:])
    return first, second


def hermite_control_points(derivatives: RealArray, duration: RealArray) -> RealArray:
    """(m, n, c) the control points next to the end where ``derivatives`` (m, n, c) hold, going ``duration`` (n,) [s]."""
    m = len(derivatives)
    degree = 2 * m - 1
    scale = [math.factorial(degree - i) / math.factorial(degree) * duration**i for i in range(m)]
    scaled = derivatives * np.stack(scale)[:, :, np.newaxis]
    binomials = np.array([[math.comb(j, i) for i in range(m)] for j in range(m)], dtype=float)
    return np.asarray(np.einsum("ji,inc->jnc", binomials, scaled))


def last_time_above(control: RealArray, start: RealArray, duration: RealArray, level: float) -> float | None:
    """Last time at which the norm of the polynomials is at least ``level``; None if it is nowhere.

    Args:
        control: (degree + 1, n, c) control points of n consecutive segments.
        start, duration: (n,) start and length of each segment.
        level: not negative, in the unit of ``control``.
    """
    reach = np.linalg.norm(control, axis=2).max(axis=0)
    for index in np.flatnonzero(reach >= level)[::-1]:
        theta = _last_theta_above(control[:, index : index + 1], level)
        if theta is not None:
            return float(start[index] + theta * duration[index])
    return None


def _last_theta_above(control: RealArray, level: float) -> float | None:
    """The same on one segment: halves are searched from the right, those whose bound stays below are dropped."""
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
