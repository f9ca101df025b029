"""Hermite interpolation between communication points: the continuous solution from which metrics are computed.

Every segment has the signal and its first ``m - 1`` time derivatives at both ends (one-sided limits, so a signal may
jump between segments). The polynomial of degree ``2 m - 1`` through them is stored in Bernstein form, whose control
points follow from the derivatives in closed form and bound the polynomial (G. Farin, *Curves and Surfaces for CAGD*,
chapters 5 and 6). With ``m = 3`` (value, velocity, acceleration) this is the quintic of order 6. Peaks, means and
crossings with their errors are found in C, see `Analysis`.

A polynomial on [0, 1] lies in the convex hull of its control points, which therefore bound it. Dividing the interval
into p parts reduces their distance from the polynomial by a factor of p².

Constant matrices lead from the ``ends`` (2 m, ...), the Taylor coefficients of order 0..m-1 about the start, over theta,
then those about the end, over 1 - theta, to the control points and to the two-point form

    p(theta) = sum over k < m of (theta (1 - theta))^k ((1 - theta) alpha_k + theta beta_k),

whose term k is what the derivatives of order k add to the polynomial through those of lower orders (P. J. Davis,
*Interpolation and Approximation*, section 2.5).
"""

from __future__ import annotations

import math
from ctypes import byref, c_double, c_size_t
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.shared_library import c_structures, shared_library
from flexfmu.cosim.engine.slave import RealArray

DIVERGING = 3.0
"""Ratio of an order's contribution to the interpolant to that of the order before, above which the order is left out:
its derivatives belong to a vibration or a decay that is far faster than the step."""

RESOLVED = 1e-6
"""Rounding of a second derivative, relative to the largest one, that is never looked at: its square is below rounding."""

LARGEST = 5, 2
"""Largest numbers of derivatives and channels for which the C code has memory."""

PEAK_TOLERANCE = 1e-11
"""Relative gap at which the search for a maximum stops: far above rounding errors, far below any metric's error."""

MAXIMUM_BISECTIONS = 60
"""Bisections after which a segment is as short as the spacing of floating-point numbers."""

SAMPLES = np.linspace(0.0, 1.0, 9)
"""Normalised times at which differences of interpolants are compared."""


@dataclass(frozen=True)
class HermiteSegments:
    """A signal with ``c`` channels on ``n`` consecutive segments.

    Attributes:
        start, end: (n,) times of the segments' ends [s]; each segment starts where the one before it ends.
        left, right: (m, n, c) time derivatives of order 0..m-1 at the start and at the end of each segment.
    """

    start: RealArray
    end: RealArray
    left: RealArray
    right: RealArray

    @cached_property
    def duration(self) -> RealArray:
        """(n,) lengths of the segments [s]."""
        return self.end - self.start

    @cached_property
    def control(self) -> RealArray:
        """(2 m, n, c) Bernstein control points over the normalised time theta in [0, 1] of each segment."""
        return self._mapped(control_matrix(len(self.left)))

    def select(self, chosen: NDArray[np.bool_] | slice) -> HermiteSegments:
        """Return the segments where the mask ``chosen`` (n,) is true, or those of a slice."""
        return HermiteSegments(self.start[chosen], self.end[chosen], self.left[:, chosen], self.right[:, chosen])

    def within(self, start: float, end: float) -> HermiteSegments:
        """Return the segments whose middle lies between the times ``start`` and ``end`` [s]."""
        middle = 0.5 * (self.start + self.end)
        begin, stop = np.searchsorted(middle, start, side="right"), np.searchsorted(middle, end, side="left")
        return self.select(slice(int(begin), int(stop)))

    def minus(self, left: RealArray, right: RealArray) -> HermiteSegments:
        """Return the deviation from a signal with these derivatives (m, n, c) at the segments' ends.

        To interpolate the deviation is more accurate than to subtract the exact signal from the interpolant: the common
        part of both signals has no interpolation error.
        """
        return HermiteSegments(self.start, self.end, self.left - left, self.right - right)

    def resolving_curvature(self, rounding: float) -> tuple[HermiteSegments, float]:
        """Return segments for the second derivative alone, and the root mean square over time of its rounding error.

        The values at both ends of a segment, right to ``rounding``, give the second derivative no better than ``rounding`` /
        duration². Where this exceeds what its own highest derivatives add to it, it is interpolated from itself and these;
        such a segment has no value and no slope at its start.
        """
        noise = rounding / self.duration**2
        if (
            len(self.left) < 4
            or not noise.size
            or noise.max() <= RESOLVED * np.linalg.norm(self.left[2], axis=-1).max()
        ):
            return self, float(noise.max(initial=0.0))
        second = HermiteSegments(self.start, self.end, self.left[2:], self.right[2:])
        short = noise > np.sqrt(contributions(*second._two_point)[-1])
        kept = float(np.sqrt(noise[~short] ** 2 @ self.duration[~short] / self.duration.sum()))
        # both integrals of the second derivative, by its control points
        left, right, control, duration = (
            self.left.copy(),
            self.right.copy(),
            second.control,
            self.duration[:, np.newaxis],
        )
        count = len(control)
        weights = np.arange(count, 0, -1.0) / (count * (count + 1.0))
        integrals = np.stack([duration**2 * np.tensordot(weights, control, axes=1), duration * control.mean(axis=0)])
        left[:2, short], right[:2, short] = 0.0, integrals[:, short]
        return HermiteSegments(self.start, self.end, left, right), kept

    @cached_property
    def consistent(self) -> HermiteSegments:
        """The segments without derivatives that are too fast for their length.

        Each order should contribute less to the interpolant than the one before it. Where an order from the second on
        contributes far more (`DIVERGING`), this order and all higher ones are left out, as an asymptotic series is
        truncated.
        """
        added, m = contributions(*self._two_point), len(self.left)
        diverging = added[1:] > DIVERGING**2 * added[:-1]
        cut = np.asarray(diverging.any(axis=0))
        if not cut.any():
            return self
        # the terms of the lower orders, as derivatives at both ends
        kept = np.arange(m)[:, np.newaxis] < 2 + diverging.argmax(axis=0)[cut]
        some = self.select(cut)
        terms = np.concatenate([np.where(kept[:, :, np.newaxis], each, 0.0) for each in some._two_point])
        ends = np.tensordot(ends_matrix(m), terms, axes=1).reshape(2, *some.left.shape) / some._scales
        left, right = self.left.copy(), self.right.copy()
        left[:, cut], right[:, cut] = ends
        return HermiteSegments(self.start, self.end, left, right)

    def evaluate(self, theta: RealArray, order: int = 0) -> RealArray:
        """Return a time derivative (k, n, c) at the normalised times ``theta`` (k,) of every segment."""
        values = self._mapped(value_matrix(len(self.left), tuple(theta.tolist()), order))
        return values / (self.duration**order)[:, np.newaxis] if order else values

    @cached_property
    def _two_point(self) -> tuple[RealArray, RealArray]:
        """Coefficients alpha and beta (m, n, c) of the two-point form."""
        start, end = self._mapped(two_point_matrix(len(self.left))).reshape(2, *self.left.shape)
        return start, end

    def _mapped(self, matrix: RealArray) -> RealArray:
        """Return the product (k, n, c) of a matrix (k, 2 m) with the ends."""
        return np.asarray((matrix @ self._ends).reshape(len(matrix), *self.left.shape[1:]))

    @cached_property
    def _ends(self) -> RealArray:
        """(2 m, n c) Taylor coefficients at both ends of each segment."""
        return (np.stack([self.left, self.right]) * self._scales).reshape(2 * len(self.left), -1)

    @cached_property
    def _scales(self) -> RealArray:
        """(2, m, n, 1) powers ±duration^k / k!, positive at the start of a segment and alternating at its end."""
        scales = np.ones((2, *self.left.shape[:2], 1))
        for k in range(1, len(self.left)):
            scales[0, k, :, 0] = scales[0, k - 1, :, 0] * (self.duration / k)
            scales[1, k] = (-1.0) ** k * scales[0, k]
        return scales


CSignal, CQuadrature = (c_structures("metrics")[f"metrics_{name}"] for name in ("signal", "quadrature"))


class Analysis:
    """What metrics are computed from, in C, without the orders of derivatives that diverge, see `HermiteSegments.consistent`.

    The m-th derivative (m odd), the first that is not interpolated, jumps between neighbouring segments in proportion to
    the signal's derivative of order 2 m, which determines the interpolation error. Only nodes count at which the
    interpolated derivatives are continuous. For a segment without such a node (alone between two breakpoints) the
    estimate is the contribution of its highest derivative; where orders were left out, that of the last one that is left
    in is added. The estimate is within a factor of two where a step is below 2 rad of the vibration, within an order of
    magnitude beyond.

    Args:
        signal: with at most `LARGEST` derivatives and channels.

    Attributes:
        diverging: number of segments in which an order diverges.
        kept: (n,) orders below the first one that diverges; all where none does.
        errors: (n,) estimated largest interpolation error of the norm within each segment.

    Raises:
        BuildError: the C code can't be compiled or loaded.
    """

    def __init__(self, signal: HermiteSegments) -> None:
        left, right, duration = signal.left, signal.right, np.ascontiguousarray(signal.duration)
        m, n, channels = left.shape
        if m > LARGEST[0] or channels > LARGEST[1]:
            raise ValueError(f"at most {LARGEST} derivatives and channels can be analysed, got {m} and {channels}")
        # one block of memory for the terms, three numbers for each segment, and the jumps at the nodes
        sizes = 2 * m * channels * n, n, n, n, channels * (n + 1)
        memory, self.kept = np.empty(sum(sizes)), np.empty(n, dtype=np.uintp)
        places = accumulate((8 * size for size in sizes[:-1]), initial=_address(memory))
        self.errors = memory[sum(sizes[:3]) : sum(sizes[:4])]
        rows = 8 * channels, 8
        left, right = (each if each.strides[1:] == rows else np.ascontiguousarray(each) for each in (left, right))
        self._start, self._duration, self._memory = signal.start, duration, (memory, left, right)
        self._signal = CSignal(
            n,
            channels,
            m,
            left.strides[0] // 8,
            right.strides[0] // 8,
            _address(duration),
            _address(left),
            _address(right),
            *map(_address, control_matrices(m)),
            *places,
            _address(self.kept),
        )
        self._library = shared_library("metrics")
        self.diverging = int(self._library.metrics_prepare(self._signal))

    def peak(self) -> tuple[float, float]:
        """Return the largest norm, both sides of every jump included, and how far it may be exceeded.

        That is how far another segment may exceed it with its interpolation error, at least the peak segment's error.
        """
        result = (c_double * 2)()
        self._library.metrics_peak(self._signal, result)
        return result[0], result[1]

    def mean_products(self, order: int = 0) -> tuple[float, ...]:
        """Return the means over time of |v|², v . e and |e|² of the time derivative v of this order.

        e is the estimated deviation of the signal's derivative from v; where only its magnitude is known, it has the
        direction of that derivative.
        """
        quadrature, integrals = quadrature_of(self._signal.orders, order), (c_double * 3)()
        points = CQuadrature(len(quadrature[0]), order, *map(_address, quadrature))
        self._library.metrics_products(self._signal, points, integrals)
        total = float(self._duration.sum())
        return tuple(each / total for each in integrals)

    def parts(self) -> tuple[float, ...]:
        """Return what the positive and the negative part of a signal with one channel are.

        These are: largest value, negated least value (both at least 0), integrals over time of the positive part and of
        the negated negative part, and the estimated errors of the extremes and of each integral.
        """
        result = (c_double * 7)()
        self._library.metrics_parts(self._signal, result)
        return tuple(result)

    def last_time_above(self, level: float) -> float | None:
        """Return the last time at which the norm is at least ``level`` (zero or positive); None if it never is."""
        segment, theta = c_size_t(), c_double()
        if not self._library.metrics_last_above(self._signal, level, byref(segment), byref(theta)):
            return None
        return float(self._start[segment.value] + theta.value * self._duration[segment.value])


def _address(array: NDArray[Any]) -> int:
    """Address of an array's first element."""
    return int(array.__array_interface__["data"][0])


@cache
def control_matrices(m: int) -> tuple[RealArray, RealArray]:
    """Matrices from the terms to the control points (2 m, 2 m), and to the highest derivative at the start (2 m,)."""
    terms = ends_matrix(m)
    row = [_signed_binomial(k + 1, m - k) for k in range(m)], [_signed_binomial(k, m - k - 1) for k in range(m)]
    highest = math.factorial(m) * np.array([[*row[0], *row[1]]]) @ two_point_matrix(m) @ terms
    return np.ascontiguousarray(control_matrix(m) @ terms), np.ascontiguousarray(highest[0])


@cache
def quadrature_of(m: int, order: int) -> tuple[RealArray, ...]:
    """Weights, values, shape and last of ``metrics_quadrature``."""
    # Gauss-Legendre on [0, 1], exact to degree 4 m + 1
    points, weights = np.polynomial.legendre.leggauss(2 * m + 1)
    theta = tuple((0.5 * (points + 1.0)).tolist())
    values = value_matrix(m, theta, order) @ ends_matrix(m)
    last = (value_matrix(m, tuple(SAMPLES.tolist()), order) @ ends_matrix(m))[:, [m - 1, 2 * m - 1]]
    # shape of the interpolation error: the derivative of (theta (theta - 1))^m / (2 m)!
    polynomial = np.polynomial.Polynomial([0.0, -1.0, 1.0]) ** m
    shape = (polynomial.deriv(order) if order else polynomial)(np.array(theta)) / math.factorial(2 * m)
    return 0.5 * weights, np.ascontiguousarray(values.T), np.asarray(shape), np.ascontiguousarray(last)


def bernstein_basis(theta: RealArray, degree: int) -> RealArray:
    """Return the Bernstein polynomials (k, degree + 1) at ``theta`` (k,)."""
    order = np.arange(degree + 1)
    binomial = np.array([math.comb(degree, int(i)) for i in order], dtype=float)
    column = np.asarray(theta, dtype=float)[:, np.newaxis]
    return np.asarray(binomial * column**order * (1.0 - column) ** (degree - order))


def largest_magnitude(control: RealArray) -> float:
    """Return the largest magnitude on [0, 1] of polynomials with Bernstein control points (degree + 1, n); NaN if one of them is NaN.

    Bisects those whose bound, the control points, exceeds the largest value found so far.
    """
    best = 0.0
    for _ in range(MAXIMUM_BISECTIONS):
        if not control.size:
            break
        # the end control points are values of the polynomial, the others are bounds
        sizes = np.abs(control)
        bounds, best = sizes.max(axis=0), max(best, float(sizes[[0, -1]].max()))
        if math.isnan(bounds.max()):
            return math.nan
        control = np.concatenate(cut(control[:, bounds > best * (1.0 + PEAK_TOLERANCE)]), axis=1)
    return best


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


def _signed_binomial(n: int, k: int) -> float:
    """Coefficient of theta^k in (1 - theta)^n."""
    return float((-1) ** k * math.comb(n, k)) if k >= 0 else 0.0
