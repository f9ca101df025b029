"""Peaks, means and crossings of a signal that is interpolated between communication points, with their errors.

In C where there is a compiler, else with numpy, a few times slower; the results agree to rounding. Orders of derivatives that
diverge are left out, see `flexfmu.cosim.metrics.segments.HermiteSegments.consistent`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.bernstein import integrals_of_parts, last_time_above, maximum_norm, norms
from flexfmu.cosim.metrics.compiled import LARGEST, CompiledAnalysis, library
from flexfmu.cosim.metrics.segments import HermiteSegments


class Analysis(Protocol):
    """What metrics are computed from.

    Attributes:
        errors: (n,) estimated largest interpolation error of the norm within each segment.
    """

    errors: RealArray

    def peak(self) -> tuple[float, float]:
        """Return the largest norm, both sides of every jump included, and how far it may be exceeded.

        That is how far another segment may exceed it with its interpolation error, at least the peak segment's error.
        """
        ...

    def mean_products(self, order: int = 0) -> tuple[float, ...]:
        """Return the means over time of |v|², v . e and |e|² of the time derivative v of this order.

        e is the estimated deviation of the signal's derivative from v, see `HermiteSegments.deviation_estimate`.
        """
        ...

    def parts(self) -> tuple[float, ...]:
        """Return what the positive and the negative part of a signal with one channel are.

        These are: largest value, negated least value (both at least 0), integrals over time of the positive part and of
        the negated negative part, and the estimated errors of the extremes and of each integral.
        """
        ...

    def last_time_above(self, level: float) -> float | None:
        """Return the last time at which the norm is at least ``level`` (zero or positive); None if it never is."""
        ...


def analyse(signal: HermiteSegments) -> Analysis:
    """Return the analysis of a signal: in C, unless it has more derivatives or channels than the C code has memory for."""
    m, _, channels = signal.left.shape
    if m > LARGEST[0] or channels > LARGEST[1] or library() is None:
        return NumpyAnalysis(signal)
    return CompiledAnalysis(signal.start, signal.duration, signal.left, signal.right)


class NumpyAnalysis:
    """See `Analysis`; vectorised over the segments."""

    def __init__(self, signal: HermiteSegments) -> None:
        self._signal = signal.consistent
        self.errors = self._signal.error_estimate()

    def peak(self) -> tuple[float, float]:
        """See `Analysis`."""
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
        """See `Analysis`."""
        points, _ = self._signal.quadrature
        values, deviation = self._signal.evaluate(points, order), self._signal.deviation_estimate(points, order)
        pairs = (values, values), (values, deviation), (deviation, deviation)
        return tuple(self._signal.mean_product(*each) for each in pairs)

    def parts(self) -> tuple[float, ...]:
        """See `Analysis`."""
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
        """See `Analysis`."""
        return last_time_above(self._signal.control, self._signal.start, self._signal.duration, level)
