"""What tuned values shall do: a figure to minimise, and conditions such as ``peak_torque_1 < 80 N.m`` or ``gain_margin > 6 dB``."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.engine.errors import InputError, suggestion
from flexfmu.cosim.engine.showing import UNITS
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, OF_BOTH, definition

MARGINS = ("gain_margin", "phase_margin", "delay_margin", "disk_margin", "sensitivity_peak")
"""Figures of the linear loop, the worst along the path; see `flexfmu.margins`."""

DECIBEL = "dB"
"""Unit of ratios: 20 times the decimal logarithm."""

_CONDITION = re.compile(
    r"\s*(?P<name>[\w.-]+)\s*(?P<sign><=?|>=?)\s*(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>[A-Za-zµ%°][\w./·*^]*)?\s*"
)


@dataclass(frozen=True)
class Goal:
    """A figure of a loop.

    Attributes:
        name: as it was asked for: of a metric, of a metric without its joint, or of a margin.
        parts: the metrics, or the margin; the figure is the largest of them.
    """

    name: str
    parts: tuple[str, ...]

    @property
    def is_margin(self) -> bool:
        """Whether it is a figure of the linear loop, not of a run."""
        return self.parts[0] in MARGINS

    @property
    def unit(self) -> str:
        """SI unit."""
        return definition(self.parts[0]).unit

    @property
    def label(self) -> str:
        """Words for tables."""
        label = definition(self.parts[0]).label
        return label if len(self.parts) == 1 else f"{label.partition(',')[0]}, both joints"

    def of(self, figures: Mapping[str, float | None], *, largest: bool = True) -> float | None:
        """The figure, from those of a loop: the larger of both joints, or the smaller; None where one is missing."""
        values = [figures.get(part) for part in self.parts]
        known = [each for each in values if each is not None and not math.isnan(each)]
        if len(known) < len(values):
            return None
        return max(known) if largest else min(known)

    def shown(self, value: float | None) -> str:
        """The value in the unit of tables."""
        if value is None:
            return "–"
        info = definition(self.parts[0])
        return f"{info.displayed(value):.4g} {info.display_unit}".rstrip()


@dataclass(frozen=True)
class Condition:
    """A limit of a figure of both joints.

    Attributes:
        goal: the figure.
        limit: of each of its parts, in the figure's SI unit.
        text: as it was written.
    """

    goal: Goal
    limit: Limit
    text: str

    def excesses(self, figures: Mapping[str, float | None]) -> list[float]:
        """How far each part of the figure is beyond the limit, see `Limit.excess`."""
        return [self.limit.excess(figures.get(part)) for part in self.goal.parts]

    def is_missed(self, figures: Mapping[str, float | None]) -> bool:
        """Whether the figure is beyond the limit, or missing."""
        return max(self.excesses(figures)) > 0.0

    def closest(self, figures: Mapping[str, float | None]) -> float | None:
        """The figure that is closest to the limit."""
        return self.goal.of(figures, largest=self.limit.is_upper)


def split(texts: Iterable[str]) -> list[str]:
    """Return the parts between commas of options that take several at once."""
    return [part.strip() for text in texts for part in text.split(",") if part.strip()]


def parse_goal(name: str) -> Goal:
    """Return the figure of a name, ``rms_tracking_error`` for the larger one of both joints, ``margin`` for the gain margin.

    Raises:
        InputError: there is no such figure.
    """
    whole = "gain_margin" if name == "margin" else name
    if whole in ALL_METRICS or whole in MARGINS:
        return Goal(name, (whole,))
    if name in OF_BOTH:
        return Goal(name, OF_BOTH[name])
    hint = suggestion(name, [*ALL_METRICS, *OF_BOTH, *MARGINS])
    raise InputError(f"there is no figure {name!r} of a run or a loop; {hint}")


def parse_condition(text: str) -> Condition:
    """Return a condition from ``FIGURE<LIMIT`` or ``FIGURE>LIMIT``; the limit may have a unit, and is in SI units without one.

    Raises:
        InputError: it has another form, or the unit isn't the figure's.
    """
    found = _CONDITION.fullmatch(text)
    if found is None or not math.isfinite(number := float(found["number"])):
        raise InputError(
            f"a condition is FIGURE<LIMIT or FIGURE>LIMIT, peak_torque_1<80 or settling_time<20ms, got {text!r}"
        )
    goal, unit = parse_goal(found["name"]), found["unit"]
    limit = Limit(goal.name, _in_si(number, unit, goal, text), goal.unit, is_upper=found["sign"].startswith("<"))
    return Condition(goal, limit, text.strip())


def _in_si(number: float, unit: str | None, goal: Goal, text: str) -> float:
    """The limit in SI units.

    Raises:
        InputError: the unit isn't the figure's.
    """
    if unit is None:
        return number
    if unit == DECIBEL and goal.unit == "1" and goal.is_margin:
        return float(10.0 ** (number / 20.0))
    base, factor = UNITS.get(unit, ("", 1.0))
    if base != goal.unit:
        own = [each for each, (si, _) in UNITS.items() if si == goal.unit and each != "1/min"] or (
            [DECIBEL] if goal.is_margin else ["no unit"]
        )
        raise InputError(f"{text!r}: {goal.name} is in {', '.join(own)}, not in {unit}")
    return float(number * factor)
