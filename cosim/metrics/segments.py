"""Hermite interpolation between communication points: the continuous solution from which metrics are computed.

Every segment has the signal and its first ``m - 1`` time derivatives at both ends (one-sided limits, so a signal may
jump between segments). The polynomial of degree ``2 m - 1`` through them is stored in Bernstein form, whose control
points follow from the derivatives in closed form and bound the polynomial (G. Farin, *Curves and Surfaces for CAGD*,
chapters 5 and 6). With ``m = 3`` (value, velocity, acceleration) this is the quintic of order 6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.bernstein import (
    SAMPLES,
    contributions,
    control_matrix,
    ends_matrix,
    gauss_legendre,
    highest_matrix,
    maximum_norm,
    node_polynomial,
    norms,
    two_point_matrix,
    value_matrix,
)

COMPARABLE_STEPS = 0.1
"""Ratio of neighbouring segments' lengths below which high derivatives in the shorter one are only rounding errors."""

DIVERGING = 3.0
"""Ratio of an order's contribution to the interpolant to that of the order before, above which the order is left out:
its derivatives belong to a vibration or a decay that is far faster than the step."""

RESOLVED = 1e-6
"""Rounding of a second derivative, relative to the largest one, that is never looked at: its square is below rounding."""

CONTINUITY = 1e-9
"""Jump of a signal or derivative, relative to its magnitude, above which a node is a breakpoint."""


@dataclass(frozen=True)
class HermiteSegments:
    """A signal with ``c`` channels on ``n`` consecutive segments.

    Attributes:
        start, end: (n,) times of the segments' ends [s]; each segment starts where the one before it ends.
        left, right: (m, n, c) time derivatives of order 0..m-1 at the start and at the end of each segment.
        doubt: estimated error of the interpolants of `consistent` where orders were left out, zero elsewhere; None
            where no order was left out.
    """

    start: RealArray
    end: RealArray
    left: RealArray
    right: RealArray
    doubt: HermiteSegments | None = None

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
        if len(self.left) < 4 or not noise.size or noise.max() <= RESOLVED * norms(self.left[2]).max():
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
        truncated; the estimated error is the contribution of the last order that is left in.
        """
        kept = self._kept_orders()
        cut = kept < len(self.left)
        if not cut.any():
            return self
        # truncated segments keep the lower orders; the last one kept gives the error
        some, kept, order = self.select(cut), kept[cut], np.arange(len(self.left))[:, np.newaxis]
        left, right, doubt = self.left.copy(), self.right.copy(), np.zeros((2, *self.left.shape))
        left[:, cut], right[:, cut] = some._of_terms(order < kept)
        doubt[:, :, cut] = some._of_terms(order == kept - 1)
        doubtful = HermiteSegments(self.start, self.end, *doubt) if np.any(doubt) else None
        return HermiteSegments(self.start, self.end, left, right, doubtful)

    def _kept_orders(self) -> NDArray[np.intp]:
        """Return the number (n,) of orders below the first that diverges, all where none does."""
        added = contributions(*self._two_point)
        if len(added) < 2:
            return np.full(self.start.size, len(self.left))
        diverging = added[1:] > DIVERGING**2 * added[:-1]
        return np.where(diverging.any(axis=0), 2 + diverging.argmax(axis=0), len(self.left))

    def evaluate(self, theta: RealArray, order: int = 0) -> RealArray:
        """Return a time derivative (k, n, c) at the normalised times ``theta`` (k,) of every segment."""
        values = self._mapped(value_matrix(len(self.left), tuple(theta.tolist()), order))
        return values / (self.duration**order)[:, np.newaxis] if order else values

    def maximum_norm(self) -> float:
        """Return the largest Euclidean norm over the channels on all segments, both sides of every jump included."""
        return maximum_norm(self.control)

    @cached_property
    def bounds(self) -> tuple[RealArray, RealArray]:
        """(n,) largest norm at the ends of each segment, and an upper bound of the norm within it."""
        start, end = self._two_point
        sizes = np.sqrt(np.maximum(*(np.einsum("knc,knc->kn", each, each) for each in (start, end))))
        return sizes[0], 0.25 ** np.arange(len(sizes)) @ sizes

    def mean_product(self, first: RealArray, second: RealArray) -> float:
        """Return the mean over time of the inner product of two signals (k, n, c) at the k points of `quadrature`."""
        _, weights = self.quadrature
        products = np.einsum("knc,knc->kn", first, second)
        return float(weights @ products @ self.duration / np.sum(self.duration))

    @property
    def quadrature(self) -> tuple[RealArray, RealArray]:
        """Normalised times and weights of Gauss quadrature, exact for products of the signal with its error."""
        return gauss_legendre(2 * len(self.left) + 1)

    def error_estimate(self) -> RealArray:
        """Return the estimated largest interpolation error of the norm within each segment (n,).

        The m-th derivative (m odd), the first that is not interpolated, jumps between neighbouring segments in
        proportion to the signal's derivative of order 2 m, which determines the interpolation error. Only nodes count
        at which the interpolated derivatives are continuous. For a segment without such a node (alone between two
        breakpoints) the estimate is the contribution of its highest derivative. The estimate is within a factor of two
        where a step is below 2 rad of the vibration, within an order of magnitude beyond.
        """
        m, derivative = len(self.left), norms(self._highest_derivatives)
        estimate: RealArray = np.fmax(*derivative) * (0.25**m / math.factorial(2 * m) * self.duration ** (2 * m))
        alone = np.asarray(np.isnan(estimate))
        if np.any(alone):
            estimate[alone] = self.select(alone)._lower_degree_change()
        if self.doubt is not None:
            estimate += norms(self.doubt.evaluate(SAMPLES)).max(axis=0)
        return estimate

    def deviation_estimate(self, theta: RealArray, order: int = 0) -> RealArray:
        """Return the estimated deviation (k, n, c) of the signal's time derivative from the interpolant's.

        Where only its magnitude is known (see `error_estimate`), it has the direction of that derivative.

        Args:
            theta: (k,) normalised times in each segment.
            order: order of the derivative, at most that of the highest interpolated one.
        """
        # mean of the known derivatives of order 2 m at both ends
        ends = self._highest_derivatives
        known = ~np.isnan(ends)
        mean = np.where(known, ends, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        deviation: RealArray = self._error_shape(theta, order)[:, :, np.newaxis] * mean
        alone = ~known.any(axis=(0, 2))
        if np.any(alone):
            # segments without a continuous node: the whole error in the direction of the derivative
            lone = self.select(np.asarray(alone))
            values = lone.evaluate(theta, order)
            norm = np.linalg.norm(values, axis=2, keepdims=True)
            direction = values / np.where(norm > 0.0, norm, 1.0)
            deviation[:, alone] = direction * lone._lower_degree_change(order)[:, np.newaxis]
        return deviation if self.doubt is None else deviation + self.doubt.evaluate(theta, order)

    @cached_property
    def _highest_derivatives(self) -> RealArray:
        """(2, n, c) derivative of order 2 m next to the start and to the end of each segment; NaN where unknown."""
        m = len(self.left)
        # jumps of the interpolant's derivative of order m at the nodes
        m = len(self.left)
        begin, stop = self._mapped(highest_matrix(m)) / (self.duration**m)[:, np.newaxis]
        first, second = self.duration[:-1], self.duration[1:]
        scale = math.factorial(2 * m) / math.factorial(m) / (first**m + second**m)
        inner = (begin[1:] - stop[:-1]) * scale[:, np.newaxis]
        # use nodes between segments of comparable length at which all interpolated derivatives are continuous
        comparable = np.minimum(first, second) > COMPARABLE_STEPS * np.maximum(first, second)
        before, after = self.right[:, :-1], self.left[:, 1:]
        differing = np.flatnonzero((before != after).any(axis=(0, 2)))
        if differing.size:
            allowed = CONTINUITY * np.maximum(norms(before), norms(after)).max(axis=1, keepdims=True)
            comparable[differing] &= np.all(norms(after[:, differing] - before[:, differing]) <= allowed, axis=0)
        inner[~comparable] = np.nan
        unknown = np.full((1, inner.shape[1]), np.nan)
        return np.stack([np.concatenate([unknown, inner]), np.concatenate([inner, unknown])])

    def _error_shape(self, theta: RealArray, order: int) -> RealArray:
        """Return the interpolation error (k, n), differentiated, of a signal with a unit derivative of order 2 m."""
        m = len(self.left)
        return np.outer(node_polynomial(m, tuple(theta.tolist()), order), self.duration ** (2 * m - order))

    def _lower_degree_change(self, order: int = 0) -> RealArray:
        """Return the largest difference (n,) from the interpolant without the highest derivative, a wide bound."""
        lower = HermiteSegments(self.start, self.end, self.left[:-1], self.right[:-1])
        return np.asarray(norms(self.evaluate(SAMPLES, order) - lower.evaluate(SAMPLES, order)).max(axis=0))

    @cached_property
    def _two_point(self) -> tuple[RealArray, RealArray]:
        """Coefficients alpha and beta (m, n, c) of the two-point form; see `flexfmu.cosim.metrics.bernstein`."""
        start, end = self._mapped(two_point_matrix(len(self.left))).reshape(2, *self.left.shape)
        return start, end

    def _of_terms(self, chosen: NDArray[np.bool_]) -> RealArray:
        """Return the derivatives (2, m, n, c) at both ends of the sum of the ``chosen`` terms (m, n)."""
        terms = np.concatenate([np.where(chosen[:, :, np.newaxis], each, 0.0) for each in self._two_point])
        ends = np.tensordot(ends_matrix(len(self.left)), terms, axes=1).reshape(2, *self.left.shape)
        return ends / self._scales

    def _mapped(self, matrix: RealArray) -> RealArray:
        """Return the product (k, n, c) of a matrix (k, 2 m) with the ends; see `flexfmu.cosim.metrics.bernstein`."""
        return np.asarray((matrix @ self._ends).reshape(len(matrix), *self.left.shape[1:]))

    @cached_property
    def _ends(self) -> RealArray:
        """(2 m, n c) Taylor coefficients at both ends of each segment; see `flexfmu.cosim.metrics.bernstein`."""
        return (np.stack([self.left, self.right]) * self._scales).reshape(2 * len(self.left), -1)

    @cached_property
    def _scales(self) -> RealArray:
        """(2, m, n, 1) powers ±duration^k / k!, positive at the start of a segment and alternating at its end."""
        scales = np.ones((2, *self.left.shape[:2], 1))
        for k in range(1, len(self.left)):
            scales[0, k, :, 0] = scales[0, k - 1, :, 0] * (self.duration / k)
            scales[1, k] = (-1.0) ** k * scales[0, k]
        return scales
