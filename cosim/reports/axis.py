"""Axes of charts: positions, ticks and their labels, as matplotlib has them: ticks at multiples of 1, 2, 2.5, 5 and 10 times a
power of ten, at most nine intervals. `templates/page.js` has the same rules for charts that are zoomed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexfmu.cosim.engine.slave import RealArray

MOST_TICKS, STEPS = 9, (1.0, 2.0, 2.5, 5.0, 10.0)
"""Largest number of intervals between ticks, and their lengths."""


@dataclass(frozen=True)
class Axis:
    """An axis from the value ``low`` at the position ``begin`` to ``high`` at ``end``.

    Attributes:
        room: length that an interval between ticks needs.
        is_log: whether the axis is logarithmic.
    """

    low: float
    high: float
    begin: float
    end: float
    room: float
    is_log: bool = False

    def at(self, value: RealArray | float) -> RealArray:
        """Return the positions of values; those that a logarithmic axis doesn't have are NaN."""
        values, low, high = np.asarray(value, dtype=float), self.low, self.high
        if self.is_log:
            values = np.log10(np.where(values > 0.0, values, np.nan))
            low, high = math.log10(low), math.log10(high)
        return np.asarray(self.begin + (values - low) * ((self.end - self.begin) / (high - low)))

    @property
    def _intervals(self) -> int:
        """Number of intervals for which there is room."""
        return min(max(int(abs(self.end - self.begin) / self.room), 1), MOST_TICKS)

    @cached_property
    def ticks(self) -> RealArray:
        """Values of the ticks: multiples of the shortest step that leaves enough room, at least two; powers of ten on a log axis."""
        if self.is_log:
            return self._decades()
        span = self.high - self.low
        raw = span / self._intervals
        power = 10.0 ** math.floor(math.log10(raw))
        fitting = [step * power for step in STEPS if step * power >= raw * (1.0 - 1e-9)]
        shorter = [step * power for step in reversed(STEPS) if step * power < raw]
        for step in (fitting[0], *shorter, STEPS[-2] * 0.1 * power):
            first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
            if last > first:
                break
        return np.asarray(step * np.arange(first, last + 1), dtype=np.float64)

    def _decades(self) -> RealArray:
        """Return powers of ten, every so many that there is room; with 2 and 5 times them where there are fewer than three."""
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        every = max(1, math.ceil((last - first) / self._intervals))
        for factors in ((1.0,), (1.0, 2.0, 5.0), tuple(range(1, 10))):
            exponents = [k for k in range(first, last + 1) if k % every == 0]
            found = np.array([float(f"{factor:g}e{k}") for k in exponents for factor in factors])
            found = found[(found >= self.low * (1.0 - 1e-9)) & (found <= self.high * (1.0 + 1e-9))]
            if found.size > 2:
                break
        return found if found.size > 1 else np.array([self.low, self.high])

    @cached_property
    def labels(self) -> list[str]:
        """Texts of the ticks, with as many decimals as tell them apart; powers of ten where there would be many zeros."""
        ticks, largest = self.ticks, float(np.max(np.abs(self.ticks)))
        if self.is_log or not 1e-4 <= largest < 1e6:
            return [f"{tick:.6g}".replace("-", "−") for tick in ticks.tolist()]
        exact = 1e-3 * float(ticks[1] - ticks[0])
        decimals = next((d for d in range(12) if np.all(np.abs(ticks - np.round(ticks, d)) < exact)), 12)
        return [f"{tick + 0.0:.{decimals}f}".replace("-", "−") for tick in ticks.tolist()]


def to_scale(x: Axis, y: Axis) -> tuple[Axis, Axis]:
    """Return axes of the same scale, as large as these ones allow, in the middle of their top."""
    across, down = x.high - x.low, y.high - y.low
    scale = min((x.end - x.begin) / across, (y.begin - y.end) / down)
    spare = 0.5 * (x.end - x.begin - scale * across)
    return (replace(x, begin=x.begin + spare, end=x.end - spare), replace(y, begin=y.end + scale * down))


def limits(values: Sequence[RealArray], margin: float, is_log: bool = False) -> tuple[float, float]:
    """Return the smallest and the largest finite value, with a margin in terms of their difference; positive ones on a log axis."""
    finite = np.concatenate([np.zeros(0), *(each[np.isfinite(each)] for each in values)])
    if is_log:
        logarithms = np.log10(finite[finite > 0.0])
        low, high = limits([logarithms if logarithms.size else np.array([-1.0, 0.0])], margin)
        return 10.0**low, 10.0**high
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        span = 0.1 * max(abs(low), abs(high)) or 0.1  # of a constant
        low, high = low - 0.5 * span, high + 0.5 * span
    return low - margin * (high - low), high + margin * (high - low)
