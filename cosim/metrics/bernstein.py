"""Polynomials in Bernstein form on many segments at once: evaluation, bounds, maxima; and through derivatives at both ends.

A polynomial on [0, 1] lies in the convex hull of its control points, which therefore bound it. Dividing the interval
into p parts reduces their distance from the polynomial by a factor of p² (G. Farin, *Curves and Surfaces for CAGD*,
chapters 5 and 6).

Those of degree 2 m - 1 through m derivatives at both ends of [0, 1] follow from constant matrices. These apply to the ``ends`` (2 m, ...): the Taylor coefficients of order 0..m-1 about the start, over theta, then
those about the end, over 1 - theta. The two-point form is

    p(theta) = sum over k < m of (theta (1 - theta))^k ((1 - theta) alpha_k + theta beta_k),

whose term k is what the derivatives of order k add to the polynomial through those of lower orders (P. J. Davis,
*Interpolation and Approximation*, section 2.5).
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


def maximum_norm(control: RealArray) -> float:
    """Return the largest norm on [0, 1] of polynomials with Bernstein control points (degree + 1, n, c).

    Divides the segments whose bound, the control points, exceeds the largest value found so far. The result is NaN if a control point is NaN.
    """
    best = 0.0
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


SAMPLES = np.linspace(0.0, 1.0, 9)
"""Normalised times at which differences of interpolants are compared."""


@cache
def control_matrix(m: int) -> RealArray:
    """Matrix (2 m, 2 m) from the ends to the Bernstein control points."""
    degree = 2 * m - 1
    near = np.array([[math.comb(j, i) / math.comb(degree, i) for i in range(m)] for j in range(m)])
    none = np.zeros((m, m))
    return np.block([[near, none], [none, near[::-1]]])


@cache
def ends_matrix(m: int) -> RealArray:
    """Matrix (2 m, 2 m) from alpha_0..alpha_{m-1}, beta_0..beta_{m-1} to the ends; its entries are integers."""
    own = np.array([[_signed_binomial(k + 1, j - k) for k in range(m)] for j in range(m)])
    other = np.array([[_signed_binomial(k, j - k - 1) for k in range(m)] for j in range(m)])
    return np.block([[own, other], [other, own]])


@cache
def two_point_matrix(m: int) -> RealArray:
    """Matrix (2 m, 2 m) from the ends to alpha_0..alpha_{m-1}, beta_0..beta_{m-1}; its entries are integers."""
    return np.asarray(np.rint(np.linalg.inv(ends_matrix(m))))


@cache
def highest_matrix(m: int) -> RealArray:
    """Matrix (2, 2 m) from the ends to the derivative of order m over theta at the start and at the end."""
    row = [_signed_binomial(k + 1, m - k) for k in range(m)], [_signed_binomial(k, m - k - 1) for k in range(m)]
    both = np.array([[*row[0], *row[1]], [*row[1], *row[0]]]) * [[1.0], [(-1.0) ** m]]
    return np.asarray(math.factorial(m) * both @ two_point_matrix(m))


@cache
def value_matrix(m: int, theta: tuple[float, ...], order: int) -> RealArray:
    """Matrix (k, 2 m) from the ends to the derivative over theta of this order at k normalised times."""
    degree = 2 * m - 1 - order
    differences = math.perm(2 * m - 1, order) * np.diff(control_matrix(m), n=order, axis=0)
    return np.asarray(bernstein_basis(np.array(theta), degree) @ differences)


@cache
def _contribution_weights(m: int) -> RealArray:
    """Weights (m - 1, 9, 3) of |alpha_k|², alpha_k . beta_k and |beta_k|² in the squared term k >= 1 at 9 times."""
    theta = SAMPLES
    shape = np.stack([(1.0 - theta) ** 2, 2.0 * theta * (1.0 - theta), theta**2], axis=-1)
    return np.stack([((theta * (1.0 - theta)) ** (2 * k))[:, np.newaxis] * shape for k in range(1, m)])


def contributions(start: RealArray, end: RealArray) -> RealArray:
    """Return the largest squared norms (m - 1, n) of the terms 1..m-1, at 9 times.

    Args:
        start, end: alpha and beta (m, n, c).
    """
    pairs = (start, start), (start, end), (end, end)
    products = np.stack([np.einsum("knc,knc->kn", one[1:], other[1:]) for one, other in pairs], axis=1)
    return np.asarray((_contribution_weights(len(start)) @ products).max(axis=1))


@cache
def node_polynomial(m: int, theta: tuple[float, ...], order: int) -> RealArray:
    """Derivative of (theta (theta - 1))^m / (2 m)! at normalised times (k,): the interpolation error's shape."""
    polynomial = np.polynomial.Polynomial([0.0, -1.0, 1.0]) ** m
    shape = polynomial.deriv(order) if order else polynomial
    return np.asarray(shape(np.array(theta)) / math.factorial(2 * m))


def _signed_binomial(n: int, k: int) -> float:
    """Coefficient of theta^k in (1 - theta)^n."""
    return float((-1) ** k * math.comb(n, k)) if k >= 0 else 0.0
