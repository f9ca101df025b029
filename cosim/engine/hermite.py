"""Two-point Hermite polynomials: the polynomial of degree 2k + 1 through value and k derivatives at both ends."""

from __future__ import annotations

from functools import cache
from math import comb, factorial

import numpy as np

from flexfmu.cosim.engine.slave import Indices, RealArray


def hermite_derivatives(left: RealArray, right: RealArray, step: float | RealArray) -> RealArray:
    """Derivatives at the left end of the Hermite polynomial between two points.

    With normalised coefficients c_j = p^(j)(0) h^j / j! the first k + 1 are given at the left end; the others solve
    sum over j > k of C(j, i) c_j = d_i - sum over j <= k of C(j, i) c_j, with d_i the normalised derivatives at the
    right end. That matrix is constant, and its inverse is integer.

    Args:
        left: (k + 1, ...) value and k derivatives at the left end.
        right: (k + 1, ...) the same at the right end.
        step: distance h of the ends, above zero; broadcasts against the trailing axes.

    Returns:
        (2k + 2, ...) value and 2k + 1 derivatives of the polynomial at the left end; the first k + 1 are ``left``.
    """
    count = left.shape[0]
    width = np.asarray(step, dtype=np.float64)
    trailing = width.reshape((1,) * (left.ndim - width.ndim) + width.shape)
    # h^j / j!, by which derivatives become coefficients
    orders, factorials = _orders(2 * count, left.ndim - 1)
    scales = trailing**orders / factorials
    known = left * scales[:count]
    from_known, from_rest = _end_matrix(count)
    # as matrices, whose product numpy finds fastest
    beyond = right * scales[:count] - from_known.dot(known.reshape(count, -1)).reshape(known.shape)
    rest = from_rest.dot(beyond.reshape(count, -1)).reshape(known.shape)
    return np.concatenate([left, rest / scales[count:]])


@cache
def _orders(count: int, dimensions: int) -> tuple[Indices, RealArray]:
    """j and j! for j below ``count``, shaped (count, ...) to broadcast against arrays of derivatives."""
    shape = (count,) + (1,) * dimensions
    factorials = np.array([factorial(j) for j in range(count)], dtype=np.float64)
    return np.arange(count).reshape(shape), factorials.reshape(shape)


@cache
def _end_matrix(count: int) -> tuple[RealArray, RealArray]:
    """C(j, i) for i, j < count, and the inverse of C(count + j, i), whose determinant is one."""
    from_known = np.array([[comb(j, i) for j in range(count)] for i in range(count)], dtype=np.float64)
    from_rest = np.array([[comb(count + j, i) for j in range(count)] for i in range(count)], dtype=np.float64)
    return from_known, np.rint(np.linalg.inv(from_rest))
