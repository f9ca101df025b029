"""A metric, a number with unit, error and names, and the metrics of a run, by attribute and by item."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cached_property, partial
from math import ceil, floor, isfinite, isnan, log10, nan
from typing import Any

from flexfmu.cosim.engine.errors import CosimError, InputError, suggestion
from flexfmu.cosim.engine.showing import html_table, shorten, shown_unit
from flexfmu.model.scene.errors import EquilibriumError


class Metric(float):
    """A metric: it calculates, compares, is formatted and written to JSON as the number that it is, in its SI unit.

        peak = flexfmu.run("barnard2012-6kg").metrics.peak_torque_1
        print(f"{peak:.3f} {peak.unit}, {2 * peak:.3f}")  # and peak.error, peak.label, peak.name

    A metric without a value (no dwell, not settled, a run that failed) is NaN, and its ``value`` is None.

    Args:
        value: None where the metric doesn't exist.
        unit: SI unit, as in files: ``N.m``; empty where there is none.
        name: as in ``summary.json`` and as ``--metrics`` takes it.
        label: short words for tables.
        description: one sentence.
        error: estimated error; None where it isn't known. A function finds it when it is first asked for.
        own, own_error: value and error of the run itself where ``value`` is that of its companion, which is the more accurate
            one; None without a companion.
        interpolation_error: estimated error of the interpolation between the run's communication points, a part of its error.
        rounding: rounding error that exceeds that of the signals themselves, a part of the error.
        reason: the run's message where the run failed and the metric has no value; otherwise empty.

    Attributes are those of the arguments.
    """

    value: float | None
    unit: str
    name: str
    label: str
    description: str
    own: float | None
    own_error: float | None
    interpolation_error: float
    rounding: float
    reason: str
    _error: float | Callable[[], float | None] | None

    def __new__(
        cls,
        value: float | None,
        unit: str = "",
        *,
        name: str = "",
        label: str = "",
        description: str = "",
        error: float | Callable[[], float | None] | None = None,
        own: float | None = None,
        own_error: float | None = None,
        interpolation_error: float = 0.0,
        rounding: float = 0.0,
        reason: str = "",
    ) -> Metric:
        number = super().__new__(cls, nan if value is None else value)
        number.value = None if value is None else float(number)
        number.unit, number.name, number.label, number.description = unit, name, label, description
        number._error, number.own, number.own_error = error, own, own_error
        number.interpolation_error, number.rounding, number.reason = interpolation_error, rounding, reason
        return number

    @property
    def error(self) -> float | None:
        """Estimated error in the same unit; None where it isn't known.

        The first error that is asked for of a run's own metrics costs a companion run, with shorter communication steps and a
        tighter tolerance, which then has those of all metrics of the run.
        """
        if callable(self._error):
            self._error = self._error()
        return self._error

    def changed(self, **changes: Any) -> Metric:
        """Return the metric with other values of some arguments."""
        kept = {name.removeprefix("_"): each for name, each in vars(self).items()}
        return Metric(**(kept | changes))

    def __repr__(self) -> str:
        """Return the number with its error where that is known, its unit, and why there is none."""
        text, bound = printed(self, None if callable(self._error) else self._error)
        text = f"{text} ± {bound}" if bound else text
        text = f"{text} {shown_unit(self.unit)}".rstrip()
        return f"{text} ({self.reason})" if self.reason else text

    __str__ = float.__repr__

    def _repr_html_(self) -> str:
        from html import escape

        name = f" (<code>{escape(self.name)}</code>)" if self.name else ""
        return f"{escape(self.label or 'metric')}{name}: {escape(repr(self))}"

    def __reduce__(self) -> tuple[object, ...]:
        """Copies and pickles have the error only if it is a number already."""
        kept = {name: each for name, each in vars(self).items() if not callable(each)}
        return partial(Metric, **{name.removeprefix("_"): each for name, each in kept.items()}), ()


DIGITS, DIGITS_WITHOUT_ERROR = 10, 6
"""Largest numbers of significant digits of a value with an error, and of one whose error isn't known."""

SMALLEST, NOISE = -15, -12
"""Powers of ten below which nothing is printed, and up to which the error of a zero isn't worth a word: both are rounding."""


def printed(value: float | None, error: float | None = None, digits: int | None = None) -> tuple[str, str]:
    """Return a value with the digits that its error allows and no others, and a bound of the printed number's error.

    The bound has one digit, in the place of the value's last one; it covers the error and the rounding to that digit. An error of
    0.3 and a value of 73.6046 are ``73.6`` and ``0.4``, an error of 4e-7 makes ``73.6046009`` and ``5e-7``.

    Args:
        value: None or NaN where there is none, a dash.
        error: in the unit of the value; None where it isn't known, which leaves the bound empty.
        digits: largest number of significant digits; None for `DIGITS`, or `DIGITS_WITHOUT_ERROR`.
    """
    if value is None or isnan(value):
        return "–", ""
    if error is None or not isfinite(error):
        return f"{float(value):.{digits or DIGITS_WITHOUT_ERROR}g}", ""
    # the last digit: the first one of the error, or the last one that there may be
    size = floor(log10(abs(value))) if value else SMALLEST
    last = max(size + 1 - (digits or DIGITS), SMALLEST, floor(log10(error) + 1e-12) if error > 0.0 else SMALLEST)
    rounded = round(value, -last)
    units = ceil((error + abs(rounded - value)) / 10.0**last - 1e-9) or 1
    size_of_bound = floor(log10(units)) + last
    bound = f"{units * 10.0**last:.0e}".replace("e-0", "e-").replace("e+0", "e")
    bound = bound if not -4 < size_of_bound < 4 else f"{units * 10.0**last:.{max(-last, 0)}f}"
    if rounded == 0.0:
        return "0", bound if last > NOISE else ""
    size = floor(log10(abs(rounded)) + 1e-12)
    return (f"{rounded:.{max(-last, 0)}f}" if -5 < size < DIGITS else f"{rounded:.{size - last}e}"), bound


class RunMetrics(Mapping[str, Metric]):
    """The metrics of a run by name, each computed when it is first asked for: ``run.metrics.peak_torque_1``.

    Values are the run's own in SI units, of `flexfmu.cosim.metrics.metric_table.COMMON_METRICS`, without simulating again. Errors
    (``run.metrics.peak_torque_1.error``) are those of these values, by the one companion run of `measure_run`, which is simulated
    when the first error is asked for; `print` then shows the companion's values, which are more accurate. In pandas:
    ``pandas.Series(run.metrics)``, ``pandas.DataFrame([run.metrics for run in runs])``.

    Args:
        name: of the scene.
        measure: function from the number of companions and some names, None for all, to the metrics.

    Raises:
        AttributeError, KeyError: there is no such metric.
        ResultsError: a signal that the metrics need was not recorded or is not finite.
        EquilibriumError: the end pose has no static equilibrium.
    """

    def __init__(self, name: str, measure: Callable[[int, Collection[str] | None], Mapping[str, Metric]]) -> None:
        self._name, self._measure = name, measure
        self._found: dict[str, Metric] = {}

    @cached_property
    def _with_errors(self) -> Mapping[str, Metric]:
        """The metrics with their errors, from one companion run."""
        return self._measure(1, None)

    @cached_property
    def _numbers(self) -> dict[str, Metric]:
        """All metrics; each is the same object as when it was asked for alone."""
        return {name: self._kept(name, each) for name, each in self._measure(0, None).items()}

    def _kept(self, name: str, measured: Metric) -> Metric:
        if name not in self._found:
            self._found[name] = measured.changed(error=lambda: self._with_errors[name].own_error)
        return self._found[name]

    def __getitem__(self, name: str) -> Metric:
        """Return a metric, computed alone."""
        if name not in self._found:
            try:
                self._kept(name, self._measure(0, [name])[name])
            except (InputError, KeyError) as error:
                known = self._names()
                raise KeyError(
                    f"this run has no metric {name!r}; {suggestion(name, known) if known else error}"
                ) from None
        return self._found[name]

    def __getattr__(self, name: str) -> Metric:
        """Return a metric as an attribute."""
        # notebooks and copies look for names that are no metrics
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(error.args[0]) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._numbers)

    def __len__(self) -> int:
        return len(self._numbers)

    def __dir__(self) -> list[str]:
        """Names for completion."""
        return sorted({*super().__dir__(), *self._names()})

    def _names(self) -> list[str]:
        """Return the names of the metrics; none where they can't be computed."""
        try:
            return [*self._numbers]
        except (CosimError, EquilibriumError):
            return []

    def __reduce__(self) -> tuple[object, ...]:
        """Copies and pickles compute the metrics again."""
        return RunMetrics, (self._name, self._measure)

    def __repr__(self) -> str:
        """Return five lines: the first three metrics and the names of the others; `print` shows all."""
        try:
            lines = self._lines()
        except (CosimError, EquilibriumError) as error:
            return f"Metrics of {self._name}, in SI units: {shorten(str(error), 200)}"
        rest = shorten(f"… {max(len(lines) - 3, 0)} more, print shows them: {', '.join([*self._numbers][3:])}", 77)
        return "\n".join([f"Metrics of {self._name}, in SI units:", *lines[:3], f"  {rest}"])

    def __str__(self) -> str:
        """Return all metrics, a line each."""
        return "\n".join([f"Metrics of {self._name}, in SI units:", *self._lines()])

    def _lines(self) -> list[str]:
        width = max(map(len, self._numbers), default=0)
        return [f"  {name:<{width}}  {shorten(repr(each), 75 - width)}" for name, each in self._shown.items()]

    @property
    def _shown(self) -> Mapping[str, Metric]:
        """The metrics; if errors are known already, the companion's."""
        return self._with_errors if "_with_errors" in self.__dict__ else self._numbers

    def _repr_html_(self) -> str:
        try:
            rows = [(name, repr(each), each.description) for name, each in self._shown.items()]
        except (CosimError, EquilibriumError) as error:
            rows = [("", str(error), "")]
        return html_table(("metric", "value", "meaning"), rows)
