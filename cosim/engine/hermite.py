"""Two-point Hermite polynomials: the polynomial of degree 2k + 1 through value and k derivatives at both ends."""

from __future__ import annotations

from functools import cache, lru_cache
from math import comb, factorial

import numpy as np

from flexfmu.cosim.engine.slave import Indices, RealArray


def hermite_derivatives(left: RealArray, right: RealArray, step: float | RealArray) -> RealArray:
    """Return the derivatives, at the left end, of the Hermite polynomial between two points.

    Let c_j = p^(j)(0) h^j / j! be the normalised coefficients. The left end gives those for j <= k; the others solve
    sum over j > k of C(j, i) c_j = d_i - sum over j <= k of C(j, i) c_j, i = 0 .. k, where d_i = p^(i)(h) h^i / i! is
    known from the right end. The matrix depends on k alone, and its inverse has integer elements.

    Args:
        left: (k + 1, ...) value and k derivatives at the left end.
        right: (k + 1, ...) value and k derivatives at the right end.
        step: distance h between the ends, positive; broadcasts against the trailing axes.

    Returns:
        (2k + 2, ...) value and 2k + 1 derivatives of the polynomial at the left end; the first k + 1 are ``left``.
    """
    count = left.shape[0]
    # h^j / j!: factors from derivatives to normalised coefficients; a run repeats few steps
    scales = (
        _scales_of_one(2 * count, left.ndim, step)
        if isinstance(step, float)
        else hermite_scales(2 * count, left.ndim, step)
    )
    known = left * scales[:count]
    from_known, from_rest = _end_matrix(count)
    # trailing axes as one, for matrix products
    beyond = right * scales[:count] - from_known.dot(known.reshape(count, -1)).reshape(known.shape)
    rest = from_rest.dot(beyond.reshape(count, -1)).reshape(known.shape)
    return np.concatenate([left, rest / scales[count:]])


def hermite_scales(count: int, dimensions: int, step: float | RealArray) -> RealArray:
    """Return h^j / j! for j < ``count``, shape (count, ...), to broadcast against arrays of derivatives."""
    width = np.asarray(step, dtype=np.float64)
    orders, factorials = _orders(count, dimensions - 1)
    scales: RealArray = width.reshape((1,) * (dimensions - width.ndim) + width.shape) ** orders / factorials
    return scales


_scales_of_one = lru_cache(maxsize=256)(hermite_scales)


@cache
def _orders(count: int, dimensions: int) -> tuple[Indices, RealArray]:
    """Return j and j! for j < ``count``, shape (count, 1, ...), to broadcast against arrays of derivatives."""
    shape = (count,) + (1,) * dimensions
    factorials = np.array([factorial(j) for j in range(count)], dtype=np.float64)
    return np.arange(count).reshape(shape), factorials.reshape(shape)


@cache
def _end_matrix(count: int) -> tuple[RealArray, RealArray]:
    """Return C(j, i) for i, j < ``count``, and the inverse of C(count + j, i), integer since its determinant is 1."""
    from_known = np.array([[comb(j, i) for j in range(count)] for i in range(count)], dtype=np.float64)
    from_rest = np.array([[comb(count + j, i) for j in range(count)] for i in range(count)], dtype=np.float64)
    return from_known, np.rint(np.linalg.inv(from_rest))
