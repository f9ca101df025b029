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
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.bernstein import (
    bernstein_basis,
    gauss_legendre,
    hermite_control_points,
    maximum_norm,
)

COMPARABLE_STEPS = 0.1
"""Ratio of neighbouring segments' lengths below which high derivatives in the shorter one are only rounding errors."""

DIVERGING = 3.0
"""Ratio of an order's contribution to the interpolant to that of the order before, above which the order is left out:
its derivatives belong to a vibration or a decay that is far faster than the step."""

ENDS = np.array([0.0, 1.0])
"""Normalised times of a segment's ends."""

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
        ahead = hermite_control_points(self.left, self.duration)
        back = hermite_control_points(self.right, -self.duration)
        return np.concatenate([ahead, back[::-1]])

    def select(self, chosen: NDArray[np.bool_]) -> HermiteSegments:
        """Return the segments where the mask ``chosen`` (n,) is true."""
        return HermiteSegments(self.start[chosen], self.end[chosen], self.left[:, chosen], self.right[:, chosen])

    def within(self, start: float, end: float) -> HermiteSegments:
        """Return the segments whose middle lies between the times ``start`` and ``end`` [s]."""
        middle = 0.5 * (self.start + self.end)
        return self.select((middle > start) & (middle < end))

    def minus(self, left: RealArray, right: RealArray) -> HermiteSegments:
        """Return the deviation from a signal with these derivatives (m, n, c) at the segments' ends.

        To interpolate the deviation is more accurate than to subtract the exact signal from the interpolant: the common
        part of both signals has no interpolation error.
        """
        return HermiteSegments(self.start, self.end, self.left - left, self.right - right)

    @cached_property
    def consistent(self) -> HermiteSegments:
        """The segments without derivatives that are too fast for their length.

        Each order should contribute less to the interpolant than the one before it. Where an order from the second on
        contributes far more (`DIVERGING`), this order and all higher ones are left out, as an asymptotic series is
        truncated; the estimated error is the contribution of the last order that is left in.
        """
        # contribution of each order of derivatives to the interpolant
        theta = np.linspace(0.0, 1.0, 9)
        values = [self._up_to(count).evaluate(theta) for count in range(1, len(self.left) + 1)]
        added = [np.linalg.norm(one - other, axis=2).max(axis=0) for one, other in pairwise(values)]
        left, right, doubt = self.left.copy(), self.right.copy(), np.zeros((2, *self.left.shape))
        # from the highest order down: truncated segments get the end derivatives of the polynomial of lower degree
        for count in range(len(added), 1, -1):
            cut = added[count - 1] > DIVERGING * added[count - 2]
            if not np.any(cut):
                continue
            kept, before = self.select(cut)._up_to(count), self.select(cut)._up_to(count - 1)
            for order in range(len(left)):
                ends = kept.evaluate(ENDS, order)
                left[order, cut], right[order, cut] = ends
                doubt[:, order, cut] = ends - before.evaluate(ENDS, order)
        doubtful = HermiteSegments(self.start, self.end, *doubt) if np.any(doubt) else None
        return HermiteSegments(self.start, self.end, left, right, doubtful)

    def _up_to(self, count: int) -> HermiteSegments:
        """Return the segments with the derivatives of order 0..count-1."""
        return HermiteSegments(self.start, self.end, self.left[:count], self.right[:count])

    def evaluate(self, theta: RealArray, order: int = 0) -> RealArray:
        """Return a time derivative (k, n, c) at the normalised times ``theta`` (k,) of every segment."""
        control = self._derivative_control(order)
        return np.tensordot(bernstein_basis(theta, len(control) - 1), control, axes=1)

    def maximum_norm(self) -> float:
        """Return the largest Euclidean norm over the channels on all segments, both sides of every jump included."""
        return maximum_norm(self.control)

    def mean_product(self, first: RealArray, second: RealArray) -> float:
        """Return the mean over time of the inner product of two signals (k, n, c) at the k points of `quadrature`."""
        _, weights = self.quadrature
        products = np.sum(first * second, axis=2)
        return float(weights @ products @ self.duration / np.sum(self.duration))

    @property
    def quadrature(self) -> tuple[RealArray, RealArray]:
        """Normalised times and weights of Gauss quadrature, exact for products of the signal with its error."""
        return gauss_legendre(len(self.control) + 1)

    def error_estimate(self) -> RealArray:
        """Return the estimated largest interpolation error of the norm within each segment (n,).

        The m-th derivative (m odd), the first that is not interpolated, jumps between neighbouring segments in
        proportion to the signal's derivative of order 2 m, which determines the interpolation error. Only nodes count
        at which the interpolated derivatives are continuous. For a segment without such a node (alone between two
        breakpoints) the estimate is the contribution of its highest derivative. The estimate is within a factor of two
        where a step is below 2 rad of the vibration, within an order of magnitude beyond.
        """
        derivative = np.fmax(*np.linalg.norm(self._highest_derivatives, axis=2))
        alone = np.asarray(np.isnan(derivative))
        estimate: RealArray = derivative * np.abs(self._error_shape(np.array([0.5]), order=0)[0])
        if np.any(alone):
            estimate[alone] = self.select(alone)._lower_degree_change()
        if self.doubt is not None:
            estimate = estimate + np.linalg.norm(self.doubt.evaluate(np.linspace(0.0, 1.0, 9)), axis=2).max(axis=0)
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
        control = self._derivative_control(m)
        jump = control[0][1:] - control[-1][:-1]
        first, second = self.duration[:-1], self.duration[1:]
        scale = math.factorial(2 * m) / math.factorial(m) / (first**m + second**m)
        # use nodes between segments of comparable length at which all interpolated derivatives are continuous
        comparable = np.minimum(first, second) > COMPARABLE_STEPS * np.maximum(first, second)
        before, after = self.right[:, :-1], self.left[:, 1:]
        size = np.maximum(np.linalg.norm(before, axis=2), np.linalg.norm(after, axis=2))
        allowed = CONTINUITY * np.maximum(size, size.max(axis=1, keepdims=True, initial=0.0))
        useful = comparable & np.all(np.linalg.norm(after - before, axis=2) <= allowed, axis=0)
        inner = np.where(useful[:, np.newaxis], jump * scale[:, np.newaxis], np.nan)
        unknown = np.full((1, jump.shape[1]), np.nan)
        return np.stack([np.concatenate([unknown, inner]), np.concatenate([inner, unknown])])

    def _error_shape(self, theta: RealArray, order: int) -> RealArray:
        """Return the interpolation error (k, n), differentiated, of a signal with a unit derivative of order 2 m."""
        m = len(self.left)
        node_polynomial = np.polynomial.Polynomial([0.0, -1.0, 1.0]) ** m
        shape = node_polynomial.deriv(order) if order else node_polynomial
        return np.outer(shape(theta), self.duration ** (2 * m - order)) / math.factorial(2 * m)

    def _derivative_control(self, order: int) -> RealArray:
        """Return the control points (2 m - order, n, c) of the interpolant's time derivative."""
        degree = len(self.control) - 1
        scale = math.perm(degree, order) / self.duration**order
        return np.asarray(np.diff(self.control, n=order, axis=0) * scale[:, np.newaxis])

    def _lower_degree_change(self, order: int = 0) -> RealArray:
        """Return the largest difference (n,) from the interpolant without the highest derivative, a wide bound."""
        lower = HermiteSegments(self.start, self.end, self.left[:-1], self.right[:-1])
        theta = np.linspace(0.0, 1.0, 9)
        change = self.evaluate(theta, order) - lower.evaluate(theta, order)
        return np.asarray(np.linalg.norm(change, axis=2).max(axis=0))
