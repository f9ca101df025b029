"""Accuracy that a user asks for, and the answer: the settings that have it, the errors of the figures, and what they cost."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from html import escape
from math import ceil, floor, inf, log10
from typing import Any

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import shown_unit

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*")
"""Number and unit of an absolute error: ``1 um``, ``0.5deg``."""


def asked_of(options: Sequence[str]) -> dict[str, float | str]:
    """Return metric → error from ``METRIC=VALUE``, a number or a percentage for a relative error, text with a unit for an absolute one.

    Raises:
        InputError: one has another form, or two name the same metric.
    """
    found: dict[str, float | str] = {}
    for text in options:
        name, _, value = (part.strip() for part in text.partition("="))
        if not name or not value:
            raise InputError(
                f"--accuracy takes METRIC=VALUE, peak_torque_1=1e-3 or end_position_error='1 um', got {text!r}"
            )
        if name in found:
            raise InputError(f"--accuracy names {name} twice; give one error for it")
        number, unit = quantity_of(value, name)
        found[name] = number / 100.0 if unit == "%" else value if unit else number
    return found


def quantity_of(text: str, name: str) -> tuple[float, str]:
    """Return number and unit, empty where there is none.

    Raises:
        InputError: it is neither.
    """
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise InputError(
            f"the accuracy of {name} is a relative error, 1e-3, or an absolute one with its unit, '1 um'; got {text!r}"
        )
    return float(match[1]), match[2]


def rounded_up(error: float) -> float:
    """The smallest number of two digits that is at least a bound of an error."""
    if not 0.0 < error < inf:
        return error
    last = 10.0 ** (floor(log10(error)) - 1)
    return ceil(error / last * (1.0 - 1e-12)) * last


def excess(share: float) -> str:
    """How far an error is beyond what is allowed, in words, of its share of that."""
    return f"by a factor of {share:.3g}" if share >= 1.1 else f"by {100.0 * (share - 1.0):.2g} %"


@dataclass(frozen=True)
class FigureError:
    """Error of a figure with the chosen settings, beside the richest model.

    Attributes:
        name, unit: of the metric.
        asked: as it was asked for.
        allowed: largest error in the SI unit.
        value: of the richest model.
        model: error by the effects that are left out.
        numerics: error by integration, communication steps and interpolation.
        reference: error of the richest model itself: change by one more mode of every family, and its numerics.
        total: bound of the error: distance from the richest model, and the error of that; model and numerics may have opposite signs.
    """

    name: str
    unit: str
    asked: str
    allowed: float
    value: float
    model: float
    numerics: float
    reference: float
    total: float

    def __str__(self) -> str:
        number, unit = quantity_of(self.asked, self.name)
        scale = self.allowed / number  # of what was asked for, in its unit

        total, model, numerics, known = (
            each / scale for each in (self.total, self.model, self.numerics, self.reference)
        )

        def text(error: float) -> str:
            return f"{error:.1e} {unit}".rstrip()

        return (
            f"{self.name}: error at most {text(rounded_up(total))} of {abs(self.value) / (scale if unit else 1.0):.4g} "
            f"{unit or shown_unit(self.unit)} (asked {self.asked}; model {text(model)}, numerics {text(numerics)} of either sign, "
            f"richest model known to {text(known)})"
        )


@dataclass(frozen=True)
class PricedSettings:
    """Settings of a run and their processor time.

    Attributes:
        text: effects, integrator, tolerance and communication step in words.
        time: processor time of a run [s].
        share: bound of the largest error in units of what was asked.
    """

    text: str
    time: float
    share: float

    def __str__(self) -> str:
        return f"{1e3 * self.time:.3g} ms with {self.text}"


TINY = 1e-300
"""Error that stands for zero in logarithms."""


@dataclass(frozen=True)
class WorkPrecisionTrial:
    """One setting of one line: a point of a diagram.

    Attributes:
        family: the figure, or another question that it belongs to, for example ``integrators``.
        line: what is varied along a line, for example ``gauss4``, or the set of effects.
        label: the setting, for example ``1e-5``.
        error: relative to the figure's value or to the largest elastic deviation; None where the run failed.
        time: processor time of a run [s]; None where the run failed.
        note: why it failed, or a remark.
    """

    family: str
    line: str
    label: str
    error: float | None
    time: float | None
    note: str = ""

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.error is None


@dataclass(frozen=True)
class WorkCurve:
    """Processor time over error for one tool: its Pareto front.

    Attributes:
        trials: the settings that no other setting of the tool beats in both error and time, by ascending error.
    """

    trials: tuple[WorkPrecisionTrial, ...]

    @classmethod
    def of(cls, trials: Iterable[WorkPrecisionTrial]) -> WorkCurve:
        """The curve of all settings that were tried; failures and those that another one beats are left out."""
        good = [each for each in trials if each.error is not None and each.time is not None]
        # from the smallest error upwards, each setting that is faster than all before it
        best: list[WorkPrecisionTrial] = []
        for each in sorted(good, key=lambda each: (each.error, each.time)):
            if not best or (each.time or 0.0) < (best[-1].time or 0.0):
                best.append(each)
        return cls(tuple(best))

    @property
    def least(self) -> float:
        """Smallest error that was reached; infinite without any."""
        return self.trials[0].error or 0.0 if self.trials else np.inf

    @property
    def most(self) -> float:
        """Largest error of a setting that none beats; 0 without any."""
        return self.trials[-1].error or 0.0 if self.trials else 0.0

    def time(self, error: float) -> float | None:
        """Processor time [s] for at most this error, logarithms interpolated between two settings; None where no setting reached it."""
        if error < max(self.least, TINY):
            return None
        errors, times = (np.array([getattr(each, key) for each in self.trials]) for key in ("error", "time"))
        return float(np.exp(np.interp(np.log(error), np.log(np.maximum(errors, TINY)), np.log(times))))


@dataclass(frozen=True)
class AccuracyAnswer:
    """The cheapest settings that have an accuracy.

    Attributes:
        figures: the figures that were asked for.
        chosen: the settings.
        default: those of the scene; None where they fail.
        dearest: the richest model, to which errors are relative, as it was integrated for that.
        following: the cheapest settings for ten times more; None where none are known.
        changes: dotted key of the scene → chosen value.
        trials: number of settings that were tried.
        why: what decided, in a sentence.
        tried: the settings that were tried, for each figure.
    """

    figures: tuple[FigureError, ...]
    chosen: PricedSettings
    default: PricedSettings | None
    dearest: PricedSettings
    following: PricedSettings | None
    changes: Mapping[str, Any]
    trials: int
    why: str
    tried: tuple[WorkPrecisionTrial, ...]

    def lines(self) -> list[str]:
        """Return the answer in sentences."""
        chosen, default, dearest = self.chosen, self.default, self.dearest
        found = [
            f"accuracy: the simulation alone takes {chosen}, the cheapest of {self.trials} settings; {self.why}",
            *map(str, self.figures),
        ]
        if default is None:
            found.append("the scene's own settings: they fail")
        else:
            verdict = "accurate enough" if default.share <= 1.0 else f"not accurate enough, {excess(default.share)}"
            found.append(f"the scene's own settings: {default}; {verdict}")
        more = "no settings are known; it needs more modes" if self.following is None else str(self.following)
        return [*found, f"the richest model: {dearest}", f"ten times more accurate: {more}"]

    def as_data(self) -> dict[str, Any]:
        """Return the answer as plain data in SI units."""
        data = asdict(replace(self, tried=())) | {"changes": dict(self.changes), "text": self.lines()}
        data.pop("tried")  # the report shows them
        return data

    def __repr__(self) -> str:
        """Return the answer, a line each."""
        return "\n".join(self.lines())

    def _repr_html_(self) -> str:
        return f"<p>{'<br>'.join(map(escape, self.lines()))}</p>"
