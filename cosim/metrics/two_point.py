"""Polynomials of degree 2 m - 1 through m derivatives at both ends of [0, 1], as constant matrices for many at once.

All matrices apply to the ``ends`` (2 m, ...): the Taylor coefficients of order 0..m-1 about the start, over theta, then
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
from flexfmu.cosim.metrics.bernstein import bernstein_basis

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
