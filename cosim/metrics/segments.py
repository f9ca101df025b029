"""Hermite interpolation between communication points: the continuous solution that the metrics are taken from.

Every segment carries its signal and the first ``m - 1`` time derivatives at both of its ends (one-sided limits, so a
signal may jump between segments). The polynomial of degree ``2 m - 1`` through them is kept in Bernstein form, whose
control points follow from the derivatives in closed form and bound the polynomial (G. Farin, *Curves and Surfaces for
CAGD*, chapters 5 and 6). With ``m = 3`` (value, velocity, acceleration) this is the quintic of order 6.
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
"""Ratio of neighbouring segments below which the shorter one says only rounding about high derivatives."""

DIVERGING = 3.0
"""Growth of what an order of derivatives adds to the interpolant over what the order before it adds, from which on the
derivatives say nothing about the segment: they belong to a vibration or a decay that is far faster than the step."""

ENDS = np.array([0.0, 1.0])
"""Normalised times of a segment's ends."""

CONTINUITY = 1e-9
"""Jump, relative to the signal's largest value, from which a node counts as a breakpoint."""


@dataclass(frozen=True)
class HermiteSegments:
    """A signal with ``c`` channels on ``n`` consecutive segments.

    Attributes:
        start, end: (n,) times of the segments' ends [s], each segment starting where the one before it ended.
        left, right: (m, n, c) the signal and its time derivatives 0..m-1 at the start and at the end of each segment.
        doubt: what the interpolants of `consistent` may be off by; zero where nothing was cut off, None if nowhere.
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
        """The segments where the mask ``chosen`` (n,) is true."""
        return HermiteSegments(self.start[chosen], self.end[chosen], self.left[:, chosen], self.right[:, chosen])

    def within(self, start: float, end: float) -> HermiteSegments:
        """The segments whose middle lies between the times ``start`` and ``end`` [s]."""
        middle = 0.5 * (self.start + self.end)
        return self.select((middle > start) & (middle < end))

    def minus(self, left: RealArray, right: RealArray) -> HermiteSegments:
        """The deviation from a signal that is known at the segments' ends, given like `left` and `right`.

        Interpolating the deviation is more accurate than comparing the interpolant with the exact signal: what both
        have in common leaves no interpolation error.
        """
        return HermiteSegments(self.start, self.end, self.left - left, self.right - right)

    @cached_property
    def consistent(self) -> HermiteSegments:
        """The same without the derivatives that don't fit the segments they stand on.

        Each order that is interpolated should add less than the one before it. Where an order from the second on adds
        far more, the segment is interpolated without it and all that follow, as an asymptotic series is cut off; its
        error is then taken for what the last order added.
        """
        # what each order of derivatives adds to the interpolant
        theta = np.linspace(0.0, 1.0, 9)
        values = [self._up_to(count).evaluate(theta) for count in range(1, len(self.left) + 1)]
        added = [np.linalg.norm(one - other, axis=2).max(axis=0) for one, other in pairwise(values)]
        left, right, doubt = self.left.copy(), self.right.copy(), np.zeros((2, *self.left.shape))
        # from the highest order down: derivatives at the ends of cut segments are those of the lower polynomial
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
        """The same with so many derivatives, the signal itself included."""
        return HermiteSegments(self.start, self.end, self.left[:count], self.right[:count])

    def evaluate(self, theta: RealArray, order: int = 0) -> RealArray:
        """(k, n, c) time derivative of some order at the normalised times ``theta`` (k,) of every segment."""
        control = self._derivative_control(order)
        return np.tensordot(bernstein_basis(theta, len(control) - 1), control, axes=1)

    def maximum_norm(self) -> float:
        """Largest Euclidean norm over the channels, anywhere on the segments, both sides of every jump included."""
        return maximum_norm(self.control)

    def mean_product(self, first: RealArray, second: RealArray) -> float:
        """Mean over time of the inner product of two signals (k, n, c), given at the k points of `quadrature`."""
        _, weights = self.quadrature
        products = np.sum(first * second, axis=2)
        return float(weights @ products @ self.duration / np.sum(self.duration))

    @property
    def quadrature(self) -> tuple[RealArray, RealArray]:
        """Normalised times and weights of Gauss quadrature, exact for products of the signal with its error."""
        return gauss_legendre(len(self.control) + 1)

    def error_estimate(self) -> RealArray:
        """(n,) estimated largest interpolation error of the norm within each segment.

        The first derivative that is not interpolated, the m-th (m odd), jumps between neighbouring segments in
        proportion to the signal's derivative of order 2 m, which is what the interpolation error depends on. A node
        counts where the interpolated derivatives themselves are continuous; a segment without such a neighbour (a
        piece of one segment between two breakpoints) is judged by the change that its own highest derivative makes.
        Within a factor of two where a step is below 2 rad of the vibration, an order of magnitude beyond.
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
        """(k, n, c) estimated difference of the signal's time derivative of some order from the interpolant's.

        Where only its size is known (see `error_estimate`) it points in the direction of that derivative.

        Args:
            theta: (k,) normalised times in each segment.
            order: order of the derivative, at most that of the highest one that is interpolated.
        """
        # the mean of what is known at both ends
        ends = self._highest_derivatives
        known = ~np.isnan(ends)
        mean = np.where(known, ends, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        deviation: RealArray = self._error_shape(theta, order)[:, :, np.newaxis] * mean
        alone = ~known.any(axis=(0, 2))
        if np.any(alone):
            # segments without neighbours, as if all of their error were in the direction of the derivative
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
        # nodes between segments of comparable length, where all interpolated derivatives agree to the accuracy of an integrator
        comparable = np.minimum(first, second) > COMPARABLE_STEPS * np.maximum(first, second)
        before, after = self.right[:, :-1], self.left[:, 1:]
        size = np.maximum(np.linalg.norm(before, axis=2), np.linalg.norm(after, axis=2))
        allowed = CONTINUITY * np.maximum(size, size.max(axis=1, keepdims=True, initial=0.0))
        useful = comparable & np.all(np.linalg.norm(after - before, axis=2) <= allowed, axis=0)
        inner = np.where(useful[:, np.newaxis], jump * scale[:, np.newaxis], np.nan)
        unknown = np.full((1, jump.shape[1]), np.nan)
        return np.stack([np.concatenate([unknown, inner]), np.concatenate([inner, unknown])])

    def _error_shape(self, theta: RealArray, order: int) -> RealArray:
        """(k, n) the signal minus its interpolant, differentiated, for a derivative of order 2 m of one."""
        m = len(self.left)
        node_polynomial = np.polynomial.Polynomial([0.0, -1.0, 1.0]) ** m
        shape = node_polynomial.deriv(order) if order else node_polynomial
        return np.outer(shape(theta), self.duration ** (2 * m - order)) / math.factorial(2 * m)

    def _derivative_control(self, order: int) -> RealArray:
        """(2 m - order, n, c) control points of the interpolant's time derivative."""
        degree = len(self.control) - 1
        scale = math.perm(degree, order) / self.duration**order
        return np.asarray(np.diff(self.control, n=order, axis=0) * scale[:, np.newaxis])

    def _lower_degree_change(self, order: int = 0) -> RealArray:
        """(n,) largest difference from the interpolant that leaves the highest derivative out: a pessimistic bound."""
        lower = HermiteSegments(self.start, self.end, self.left[:-1], self.right[:-1])
        theta = np.linspace(0.0, 1.0, 9)
        change = self.evaluate(theta, order) - lower.evaluate(theta, order)
        return np.asarray(np.linalg.norm(change, axis=2).max(axis=0))
