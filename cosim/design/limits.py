"""Limits: what a plan, a tuning or a choice of shapers keeps to, each with what is used of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from flexfmu.trajectories.jets import RealArray


@dataclass(frozen=True)
class Limit:
    """A limit of a figure, and what a motion or a loop uses of it.

    Attributes:
        figure: what is limited.
        limit: the largest value, or the smallest, in the unit; of a relative limit a multiple of what the given motion needs.
        unit: SI unit of the figure; 1 for such a multiple.
        is_upper: whether it is the largest value, otherwise the smallest.
        is_relative: whether it is a multiple.
        rounding: relative excess that counts as rounding.
        value: what is needed, in the unit; NaN where it isn't known.
        where: time, joint, payload of that value.
    """

    figure: str
    limit: float
    unit: str
    is_upper: bool = True
    is_relative: bool = False
    rounding: float = 0.0
    value: float = math.nan
    where: str = ""

    @property
    def name(self) -> str:
        """The figure, and whether a ratio of it is limited."""
        return f"{self.figure} ratio" if self.is_relative else self.figure

    @property
    def share(self) -> float:
        """Used share of an upper limit: 1 at the limit."""
        return self.value / self.limit

    @property
    def met(self) -> bool:
        """Whether the limit is kept."""
        if self.is_upper:
            return self.value <= self.limit * (1.0 + self.rounding)
        return self.value >= self.limit * (1.0 - self.rounding)

    def used(self, value: float, where: str = "") -> Limit:
        """The limit with what is used of it."""
        return replace(self, value=value, where=where)

    def resolved(self, usual: RealArray) -> RealArray:
        """The limit in the unit of the figure, from what the given motion needs."""
        return usual * self.limit if self.is_relative else np.full_like(usual, self.limit)

    def excess(self, value: float | None) -> float:
        """How far a value is beyond the limit, relative to it; negative within it, infinite without a value.

        For a limit of zero it is the distance itself.
        """
        if value is None or math.isnan(value):
            return math.inf
        distance = value - self.limit if self.is_upper else self.limit - value
        return distance / abs(self.limit) if self.limit else distance
