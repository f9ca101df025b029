"""Peaks, means and crossings of a signal that is interpolated between communication points, with their errors.

In C where there is a compiler, else with numpy, a few times slower; the results agree to rounding. Orders of derivatives that
diverge are left out, see `flexfmu.cosim.metrics.segments.HermiteSegments.consistent`.

Peaks, means and crossings of Hermite segments in C; `flexfmu.cosim.metrics.analysis` does without a compiler.
"""

from __future__ import annotations

from ctypes import POINTER, Structure, byref, c_double, c_int, c_size_t, c_void_p
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.shared_library import shared_library
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.bernstein import (
    SAMPLES,
    control_matrix,
    ends_matrix,
    gauss_legendre,
    highest_matrix,
    integrals_of_parts,
    last_time_above,
    maximum_norm,
    node_polynomial,
    norms,
    value_matrix,
)
from flexfmu.cosim.metrics.segments import HermiteSegments

LARGEST = 5, 2
"""Largest numbers of derivatives and channels for which the C code has memory."""


class CSignal(Structure):
    """``metrics_signal`` of ``metrics.h``."""

    _fields_ = (
        *((name, c_size_t) for name in ("segments", "channels", "orders", "left_stride", "right_stride")),
        *((name, c_void_p) for name in ("duration", "left", "right", "control", "highest")),
        *((name, c_void_p) for name in ("terms", "ends", "bounds", "errors", "jumps", "kept")),
    )


class CQuadrature(Structure):
    """``metrics_quadrature`` of ``metrics.h``."""

    _fields_ = (
        *((name, c_size_t) for name in ("points", "order")),
        *((name, c_void_p) for name in ("weights", "values", "shape", "last")),
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
            ("parts", None, (pair,)),
            ("last_above", c_int, (c_double, size, pair)),
        ):
            function = getattr(found, f"metrics_{name}")
            function.restype, function.argtypes = result, (POINTER(CSignal), *arguments)
    return found


class CompiledAnalysis:
    """Analysis of Hermite segments in C, without the orders of derivatives that diverge.

    See `NumpyAnalysis`.

    Args:
        start, duration: (n,) starts and lengths of the segments [s].
        left, right: (m, n, c) derivatives at both ends of the segments, at most `LARGEST` orders and channels.

    Attributes:
        diverging: number of segments in which an order diverges.
        kept: (n,) orders below the first one that diverges; all where none does.
        errors: (n,) estimated interpolation errors.
    """

    def __init__(self, start: RealArray, duration: RealArray, left: RealArray, right: RealArray) -> None:
        m, n, channels = left.shape
        # one block of memory for the terms, three numbers for each segment, and the jumps at the nodes
        sizes = 2 * m * channels * n, n, n, n, channels * (n + 1)
        memory, self.kept = np.empty(sum(sizes)), np.empty(n, dtype=np.uintp)
        places = accumulate((8 * size for size in sizes[:-1]), initial=_address(memory))
        self.errors = memory[sum(sizes[:3]) : sum(sizes[:4])]
        rows = 8 * channels, 8
        left, right = (each if each.strides[1:] == rows else np.ascontiguousarray(each) for each in (left, right))
        duration = np.ascontiguousarray(duration)
        self._start, self._duration, self._memory = start, duration, (memory, left, right)
        self._signal = CSignal(
            n,
            channels,
            m,
            left.strides[0] // 8,
            right.strides[0] // 8,
            _address(duration),
            _address(left),
            _address(right),
            *map(_address, _matrices(m)),
            *places,
            _address(self.kept),
        )
        self._library = library()
        self.diverging = int(self._library.metrics_prepare(byref(self._signal)))

    def peak(self) -> tuple[float, float]:
        """See `NumpyAnalysis`."""
        result = (c_double * 2)()
        self._library.metrics_peak(byref(self._signal), result)
        return result[0], result[1]

    def mean_products(self, order: int = 0) -> tuple[float, ...]:
        """See `NumpyAnalysis`."""
        quadrature, integrals = _quadrature(self._signal.orders, order), (c_double * 3)()
        points = CQuadrature(len(quadrature[0]), order, *map(_address, quadrature))
        self._library.metrics_products(byref(self._signal), byref(points), integrals)
        total = float(self._duration.sum())
        return tuple(each / total for each in integrals)

    def parts(self) -> tuple[float, ...]:
        """See `NumpyAnalysis`."""
        result = (c_double * 7)()
        self._library.metrics_parts(byref(self._signal), result)
        return tuple(result)

    def last_time_above(self, level: float) -> float | None:
        """See `NumpyAnalysis`."""
        segment, theta = c_size_t(), c_double()
        if not self._library.metrics_last_above(byref(self._signal), level, byref(segment), byref(theta)):
            return None
        return float(self._start[segment.value] + theta.value * self._duration[segment.value])


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


def analyse(signal: HermiteSegments) -> CompiledAnalysis | NumpyAnalysis:
    """Return the analysis of a signal: in C, unless it has more derivatives or channels than the C code has memory for."""
    m, _, channels = signal.left.shape
    if m > LARGEST[0] or channels > LARGEST[1] or library() is None:
        return NumpyAnalysis(signal)
    return CompiledAnalysis(signal.start, signal.duration, signal.left, signal.right)


class NumpyAnalysis:
    """What metrics are computed from, vectorised over the segments, without the orders of derivatives that diverge.

    Args:
        signal: the signal.

    Attributes:
        errors: (n,) estimated largest interpolation error of the norm within each segment.
    """

    def __init__(self, signal: HermiteSegments) -> None:
        self._signal = signal.consistent
        self.errors = self._signal.error_estimate()

    def peak(self) -> tuple[float, float]:
        """Return the largest norm, both sides of every jump included, and how far it may be exceeded.

        That is how far another segment may exceed it with its interpolation error, at least the peak segment's error.
        """
        (ends, bounds), errors = self._signal.bounds, self.errors
        # only segments that may reach the peak, with or without their error; NaN compares as false and isn't left out
        at_ends = float(ends.max(initial=0.0))
        chosen = ~((bounds < at_ends) & (bounds + errors < np.max(ends + errors, initial=0.0)))
        some, errors = self._signal.select(chosen), errors[chosen]
        largest = maximum_norm(some.control, at_ends)
        reached = norms(some.evaluate(np.linspace(0.0, 1.0, 4 * len(some.left)))).max(axis=0)
        exceeded = float(np.max(reached + errors, initial=0.0)) - largest
        return largest, max(exceeded, float(errors[np.argmax(reached)]) if reached.size else 0.0)

    def mean_products(self, order: int = 0) -> tuple[float, ...]:
        """Return the means over time of |v|², v . e and |e|² of the time derivative v of this order.

        e is the estimated deviation of the signal's derivative from v, see `HermiteSegments.deviation_estimate`.
        """
        points, _ = self._signal.quadrature
        values, deviation = self._signal.evaluate(points, order), self._signal.deviation_estimate(points, order)
        pairs = (values, values), (values, deviation), (deviation, deviation)
        return tuple(self._signal.mean_product(*each) for each in pairs)

    def parts(self) -> tuple[float, ...]:
        """Return what the positive and the negative part of a signal with one channel are.

        These are: largest value, negated least value (both at least 0), integrals over time of the positive part and of
        the negated negative part, and the estimated errors of the extremes and of each integral.
        """
        control, (ends, bounds), errors = self._signal.control, self._signal.bounds, self.errors
        # values above the least are norms
        size = float(np.abs(control).max(initial=0.0))
        extremes = [max(maximum_norm(sign * control + size) - size, 0.0) for sign in (1.0, -1.0)]
        integrals = integrals_of_parts(control[..., 0], self._signal.duration)
        reaching = bounds + errors >= min(extremes)
        # each integral's error is that of the segments which may have such a part
        (first, last), rest = control[[0, -1], :, 0], bounds - ends
        positive, negative = (np.minimum(sign * first, sign * last) >= rest for sign in (1.0, -1.0))
        doubts = errors * self._signal.duration
        parts = float(doubts[~negative].sum()), float(doubts[~positive].sum())
        return *extremes, *integrals, float(errors[reaching].max(initial=0.0)), *parts

    def last_time_above(self, level: float) -> float | None:
        """Return the last time at which the norm is at least ``level`` (zero or positive); None if it never is."""
        return last_time_above(self._signal.control, self._signal.start, self._signal.duration, level)
