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

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.bernstein import Array, bernstein_basis, gauss_legendre, hermite_control_points, maximum_norm

COMPARABLE_STEPS = 1e-3
"""Ratio of neighbouring segments below which the shorter one says only rounding about high derivatives."""

CONTINUITY = 1e-9
"""Jump, relative to the signal's largest value, from which a node counts as a breakpoint."""


@dataclass(frozen=True)
class HermiteSegments:
    """A signal with ``c`` channels on ``n`` consecutive segments.

    Attributes:
        start, end: (n,) times of the segments' ends [s], each segment starting where the one before it ended.
        left, right: (m, n, c) the signal and its time derivatives 0..m-1 at the start and at the end of each segment.
    """

    start: Array
    end: Array
    left: Array
    right: Array

    @cached_property
    def duration(self) -> Array:
        """(n,) lengths of the segments [s]."""
        return self.end - self.start

    @cached_property
    def control(self) -> Array:
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

    def minus(self, left: Array, right: Array) -> HermiteSegments:
        """The deviation from a signal that is known at the segments' ends, given like `left` and `right`.

        Interpolating the deviation is more accurate than comparing the interpolant with the exact signal: what both
        have in common leaves no interpolation error.
        """
        return HermiteSegments(self.start, self.end, self.left - left, self.right - right)

    def evaluate(self, theta: Array) -> Array:
        """(k, n, c) values at the normalised times ``theta`` (k,) of every segment."""
        return np.tensordot(bernstein_basis(theta, len(self.control) - 1), self.control, axes=1)

    def maximum_norm(self) -> float:
        """Largest Euclidean norm over the channels, anywhere on the segments, both sides of every jump included."""
        return maximum_norm(self.control)

    def mean_square(self) -> float:
        """Mean over time of the squared norm: Gauss quadrature with as many points as integrate it exactly."""
        points, weights = gauss_legendre(len(self.control))
        squares = np.sum(self.evaluate(points) ** 2, axis=2)
        return float(weights @ squares @ self.duration / np.sum(self.duration))

    def error_estimate(self) -> Array:
        """(n,) estimated largest interpolation error of the norm within each segment.

        The first derivative that is not interpolated, the m-th, jumps between neighbouring segments in proportion to
        the derivative of order 2 m of the signal, which is what the interpolation error depends on. A node counts
        where the interpolated derivatives themselves are continuous; a segment without such a neighbour (a piece of
        one segment between two breakpoints) is judged by the change that its own highest derivative makes. Within a
        factor of two where a step is below 2 rad of the vibration, an order of magnitude beyond.
        """
        order = 2 * len(self.left)
        inner = self._node_derivatives()
        derivative = np.fmax(np.concatenate([[np.nan], inner]), np.concatenate([inner, [np.nan]]))
        estimate: Array = derivative * self.duration**order / (math.factorial(order) * 2**order)
        alone = np.isnan(estimate)
        if np.any(alone):
            estimate[alone] = self.select(alone)._lower_degree_change()
        return estimate

    def _node_derivatives(self) -> Array:
        """(n - 1,) norm of the derivative of order 2 m at the inner nodes; NaN where a node tells nothing."""
        m = len(self.left)
        jump = np.linalg.norm(self._uninterpolated(at_end=False)[1:] - self._uninterpolated(at_end=True)[:-1], axis=1)
        first, second = self.duration[:-1], self.duration[1:]
        derivative = jump * math.factorial(2 * m) / math.factorial(m) / (first**m + second**m)
        useful = _continuous(self.right[:, :-1], self.left[:, 1:]) & (
            np.minimum(first, second) > COMPARABLE_STEPS * np.maximum(first, second)
        )
        return np.where(useful, derivative, np.nan)

    def _uninterpolated(self, *, at_end: bool) -> Array:
        """(n, c) the interpolant's derivative of order m at the start or end of each segment."""
        m, degree = len(self.left), len(self.control) - 1
        differences = np.diff(self.control, n=m, axis=0)
        scale = math.factorial(degree) / math.factorial(degree - m) / self.duration**m
        return np.asarray(differences[-1 if at_end else 0] * scale[:, np.newaxis])

    def _lower_degree_change(self) -> Array:
        """(n,) largest difference from the interpolant that leaves the highest derivative out: a pessimistic bound."""
        lower = HermiteSegments(self.start, self.end, self.left[:-1], self.right[:-1])
        theta = np.linspace(0.0, 1.0, 9)
        return np.asarray(np.linalg.norm(self.evaluate(theta) - lower.evaluate(theta), axis=2).max(axis=0))


def _continuous(before: Array, after: Array) -> NDArray[np.bool_]:
    """(n,) whether all the derivatives (m, n, c) agree, to the accuracy of an integrator, across each node."""
    jump = np.linalg.norm(after - before, axis=2)
    size = np.maximum(np.linalg.norm(before, axis=2), np.linalg.norm(after, axis=2))
    return np.asarray(
        np.all(jump <= CONTINUITY * np.maximum(size, size.max(axis=1, keepdims=True, initial=0.0)), axis=0)
    )
