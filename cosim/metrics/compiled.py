"""Extrema, means and crossings of Hermite segments in C; `flexfmu.cosim.metrics.segments` does without a compiler."""

from __future__ import annotations

from ctypes import POINTER, Structure, byref, c_double, c_int, c_size_t, c_void_p
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.shared_library import shared_library
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.bernstein import gauss_legendre
from flexfmu.cosim.metrics.two_point import (
    SAMPLES,
    control_matrix,
    ends_matrix,
    highest_matrix,
    node_polynomial,
    value_matrix,
)

LARGEST = 5, 2
"""Largest numbers of derivatives and channels for which the C code has memory."""


class CSignal(Structure):
    """``metrics_signal`` of ``metrics.h``."""

    _fields_ = (
        *((name, c_size_t) for name in ("segments", "channels", "orders", "left_stride", "right_stride")),
        *((name, c_void_p) for name in ("duration", "left", "right", "doubt", "control", "highest")),
        *((name, c_void_p) for name in ("terms", "ends", "bounds", "errors", "jumps", "kept")),
    )


class CQuadrature(Structure):
    """``metrics_quadrature`` of ``metrics.h``."""

    _fields_ = (
        *((name, c_size_t) for name in ("points", "order")),
        *((name, c_void_p) for name in ("weights", "values", "shape", "last", "doubt")),
    )


@cache
def library() -> Any:
    """The C library; None if it can't be compiled or loaded, for example without a C compiler."""
    found: Any = shared_library("flexfmu.cosim.metrics", "c-metrics")
    if found is not None:
        pair, size = POINTER(c_double), POINTER(c_size_t)
        for name, result, arguments in (
            ("prepare", c_size_t, ()),
            ("peak", None, (pair,)),
            ("products", None, (POINTER(CQuadrature), pair)),
            ("last_above", c_int, (c_double, size, pair)),
        ):
            function = getattr(found, f"metrics_{name}")
            function.restype, function.argtypes = result, (POINTER(CSignal), *arguments)
    return found


class CompiledSegments:
    """Analysis of Hermite segments in C.

    Args:
        duration: (n,) lengths of the segments [s].
        left, right: (m, n, c) derivatives at both ends of the segments, at most `LARGEST` orders and channels.
        doubt: (n,) error of the orders that were left out; None for none.

    Attributes:
        diverging: number of segments in which an order diverges.
        kept: (n,) orders below the first one that diverges; all where none does.
        errors: (n,) estimated interpolation errors.
    """

    def __init__(self, duration: RealArray, left: RealArray, right: RealArray, doubt: RealArray | None) -> None:
        m, n, channels = left.shape
        # one block of memory for the terms, three numbers for each segment, and the jumps at the nodes
        sizes = 2 * m * channels * n, n, n, n, channels * (n + 1)
        memory, self.kept = np.empty(sum(sizes)), np.empty(n, dtype=np.uintp)
        places = accumulate((8 * size for size in sizes[:-1]), initial=_address(memory))
        self.errors = memory[sum(sizes[:3]) : sum(sizes[:4])]
        rows = 8 * channels, 8
        left, right = (each if each.strides[1:] == rows else np.ascontiguousarray(each) for each in (left, right))
        duration = np.ascontiguousarray(duration)
        doubt = None if doubt is None else np.ascontiguousarray(doubt)
        self._memory = memory, duration, left, right, doubt
        self._signal = CSignal(
            n,
            channels,
            m,
            left.strides[0] // 8,
            right.strides[0] // 8,
            _address(duration),
            _address(left),
            _address(right),
            None if doubt is None else _address(doubt),
            *map(_address, _matrices(m)),
            *places,
            _address(self.kept),
        )
        self._library = library()
        self.diverging = int(self._library.metrics_prepare(byref(self._signal)))

    def peak(self) -> tuple[float, float]:
        """Return the largest norm, and how far it may be exceeded."""
        result = (c_double * 2)()
        self._library.metrics_peak(byref(self._signal), result)
        return result[0], result[1]

    def products(self, order: int, doubt: RealArray | None) -> tuple[float, float, float]:
        """Return the integrals of |v|², v . e and |e|² of the derivative v of this order and its estimated deviation e.

        Args:
            order: of the derivative.
            doubt: (k, n, c) part of e at the points of the quadrature, or None.
        """
        m, result = self._signal.orders, (c_double * 3)()
        given = None if doubt is None else np.ascontiguousarray(doubt)
        quadrature = _quadrature(m, order)
        fields = *map(_address, quadrature), None if given is None else _address(given)
        self._library.metrics_products(
            byref(self._signal), byref(CQuadrature(len(quadrature[0]), order, *fields)), result
        )
        return result[0], result[1], result[2]

    def last_above(self, level: float) -> tuple[int, float] | None:
        """Return the last segment, and the normalised time in it, at which the norm is at least ``level``."""
        segment, theta = c_size_t(), c_double()
        found = self._library.metrics_last_above(byref(self._signal), level, byref(segment), byref(theta))
        return (segment.value, theta.value) if found else None


def _address(array: NDArray[Any]) -> int:
    """Address of an array's first element."""
    return int(array.__array_interface__["data"][0])


@cache
def _matrices(m: int) -> tuple[RealArray, RealArray]:
    """Matrices from the terms to the control points (2 m, 2 m), and to the highest derivative at the start (2 m,)."""
    terms = ends_matrix(m)
    return np.ascontiguousarray(control_matrix(m) @ terms), np.ascontiguousarray((highest_matrix(m) @ terms)[0])


@cache
def _quadrature(m: int, order: int) -> tuple[RealArray, ...]:
    """Weights, values, shape and last of ``metrics_quadrature``."""
    points, weights = gauss_legendre(2 * m + 1)
    theta = tuple(points.tolist())
    values = value_matrix(m, theta, order) @ ends_matrix(m)
    last = (value_matrix(m, tuple(SAMPLES.tolist()), order) @ ends_matrix(m))[:, [m - 1, 2 * m - 1]]
    return weights, np.ascontiguousarray(values.T), node_polynomial(m, theta, order), np.ascontiguousarray(last)
