"""Polynomials in Bernstein form on many segments at once: evaluation, bounds, maxima.

A polynomial on [0, 1] lies in the convex hull of its control points, which therefore bound it. Dividing the interval
into p parts reduces their distance from the polynomial by a factor of p² (G. Farin, *Curves and Surfaces for CAGD*,
chapters 5 and 6).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from flexfmu.cosim.engine.slave import RealArray

PEAK_TOLERANCE = 1e-11
"""Relative gap at which the search for a maximum stops: far above rounding errors, far below any metric's error."""

HALVINGS = 5
"""Bisections of all segments at once in each round of a search."""

MAXIMUM_BISECTIONS = 60
"""Bisections after which a segment is as short as the spacing of floating-point numbers."""


ZERO_BISECTIONS = 30
"""Bisections at a zero, beyond which a polynomial's integral is below rounding."""


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


def norms(vectors: RealArray) -> RealArray:
    """Return the Euclidean norms (...) of vectors (..., c)."""
    if vectors.shape[-1] == 1:
        return np.abs(vectors[..., 0])
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", vectors, vectors)))


def maximum_norm(control: RealArray, least: float = 0.0) -> float:
    """Return the largest norm on [0, 1] of polynomials with Bernstein control points (degree + 1, n, c).

    Divides the segments whose bound, the control points, exceeds the largest value found so far, which is at least
    ``least``. The result is NaN if a control point is NaN.
    """
    best = least
    for _ in range(0, MAXIMUM_BISECTIONS, HALVINGS):
        if control.shape[1] == 0:
            break
        # the end control points are values of the polynomial, the others are bounds
        sizes = norms(control)
        bounds = sizes.max(axis=0)
        best = max(best, float(sizes[0].max()), float(sizes[-1].max()))
        if math.isnan(bounds.max()):
            return math.nan
        # divide only segments that may exceed the largest value
        control = divide(control[:, bounds > best * (1.0 + PEAK_TOLERANCE)])
    return best


def divide(control: RealArray) -> RealArray:
    """Return the control points (degree + 1, n p, c) of the p = 2^`HALVINGS` equal parts of every segment."""
    count, n, channels = control.shape
    parts = _division(count) @ control.reshape(count, n * channels)
    return np.asarray(parts.reshape(count, -1, channels))


@cache
def _division(count: int) -> RealArray:
    """Matrix from ``count`` control points to those of all parts; its rows are ordered by control point, then part."""
    parts = np.eye(count)[:, np.newaxis]
    for _ in range(HALVINGS):
        parts = np.stack(cut(parts), axis=2).reshape(count, -1, count)
    return parts.reshape(-1, count)


def cut(control: RealArray, theta: float = 0.5) -> tuple[RealArray, RealArray]:
    """Return the control points (degree + 1, ...) of both parts of every segment, before and after a normalised time.

    By de Casteljau's algorithm.
    """
    first, second, level = np.empty_like(control), np.empty_like(control), control
    for i in range(len(control)):
        # the ends of each level of averages are control points of the parts
        first[i], second[-1 - i] = level[0], level[-1]
        level = (1.0 - theta) * level[:-1] + theta * level[1:]
    return first, second


def integrals_of_parts(control: RealArray, duration: RealArray) -> tuple[float, float]:
    """Return the integrals over time of the positive part and of the negated negative part of polynomials.

    The integral of a polynomial is the mean of its control points; those with both signs are divided until the rest is far
    below rounding.

    Args:
        control: (degree + 1, n) control points.
        duration: (n,) lengths of the segments.
    """
    parts = np.zeros(2)
    for remaining in range(ZERO_BISECTIONS, -1, -1):
        mixed = (control.min(axis=0) < 0.0) & (control.max(axis=0) > 0.0) & (remaining > 0)
        integrals = control[:, ~mixed].mean(axis=0) * duration[~mixed]
        parts += np.maximum(integrals, 0.0).sum(), np.maximum(-integrals, 0.0).sum()
        if not mixed.any():
            break
        control = np.concatenate(cut(control[:, mixed]), axis=1)
        duration = np.tile(0.5 * duration[mixed], 2)
    return float(parts[0]), float(parts[1])


def last_time_above(control: RealArray, start: RealArray, duration: RealArray, level: float) -> float | None:
    """Return the last time at which the norm of the polynomials is at least ``level``; None if it is below throughout.

    Args:
        control: (degree + 1, n, c) control points of n consecutive segments.
        start, duration: (n,) start and length of each segment.
        level: zero or positive, in the unit of ``control``.
    """
    reach = norms(control).max(axis=0)
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
        sizes = norms(piece[:, 0])
        if sizes.max() < level:
            continue
        middle = 0.5 * (left + right)
        if sizes[-1] >= level or not left < middle < right:
            return right
        first, second = cut(piece)
        pieces += [(first, left, middle), (second, middle, right)]
    return None
