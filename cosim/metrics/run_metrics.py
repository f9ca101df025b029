"""The metrics of a run as numbers with units and errors, by attribute and by item."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

from flexfmu.cosim.engine.errors import CosimError, InputError, suggestion
from flexfmu.cosim.engine.showing import html_table, shorten
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, COMMON_METRICS, Measurement, printed
from flexfmu.cosim.metrics.metrics import Metrics, measure_run, settings_for, with_errors
from flexfmu.model.scene.errors import EquilibriumError


class Quantity(float):
    """A number in an SI unit, that of a metric: it calculates and is formatted as a number, and its `repr` has the unit.

    A metric without a value (no dwell, not settled, a run that failed) is NaN, and ``reason`` says why where that is known.

    Attributes:
        unit: SI unit.
        reason: why there is no value; otherwise empty.
    """

    unit: str
    reason: str

    def __new__(
        cls, value: float, unit: str = "", reason: str = "", error: float | Callable[[], float | None] | None = None
    ) -> Quantity:
        """Return the number with its unit; ``error`` may be a function that finds the error when it is first asked for."""
        number = super().__new__(cls, value)
        number.unit, number.reason, number._error = unit, reason, error
        return number

    _error: float | Callable[[], float | None] | None

    @property
    def error(self) -> float | None:
        """Estimated error in the same unit; None where it isn't known.

        The first error that is asked for costs a companion run, with shorter communication steps and a tighter tolerance,
        which then has those of all metrics of the run.
        """
        return self._error() if callable(self._error) else self._error

    def __repr__(self) -> str:
        """Return the number with its unit, and why there is none."""
        text = f"{float(self)!r} {self.unit}".rstrip()
        return f"{text} ({self.reason})" if self.reason else text

    __str__ = float.__repr__

    def __reduce__(self) -> tuple[object, ...]:
        """Copies and pickles have the error only if it is a number already."""
        return Quantity, (float(self), self.unit, self.reason, None if callable(self._error) else self._error)


class RunMetrics(Mapping[str, Quantity]):
    """The metrics of a run by name, each computed when it is first asked for: ``run.metrics.peak_torque_1``.

    Values are the run's own in SI units, of `flexfmu.cosim.metrics.metric_table.COMMON_METRICS`, without simulating again. Errors
    (``run.metrics.peak_torque_1.error``) are those of these values, by the one companion run of `measure_run`, which is simulated
    when the first error is asked for; `print` then shows the companion's values, which are more accurate. In pandas:
    ``pandas.Series(run.metrics)``, ``pandas.DataFrame([run.metrics for run in runs])``.

    Args:
        run: the run.

    Raises:
        AttributeError, KeyError: there is no such metric.
        ResultsError: a signal that the metrics need was not recorded or is not finite.
        EquilibriumError: the end pose has no static equilibrium.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._found: dict[str, Quantity] = {}

    @cached_property
    def _measured(self) -> Metrics[Measurement]:
        return measure_run(self._run, companions=0)

    @cached_property
    def _with_errors(self) -> Metrics[Measurement]:
        """The metrics with their errors, from one companion run."""
        if not self._run.completed:
            return self._measured
        return with_errors(self._run, self._measured, settings_for(self._run))

    @cached_property
    def _numbers(self) -> dict[str, Quantity]:
        """All metrics; each is the same object as when it was asked for alone."""
        return {name: self._found.setdefault(name, self._number(name, each)) for name, each in self._measured.items()}

    def _number(self, name: str, measured: Measurement) -> Quantity:
        value = math.nan if measured.value is None else measured.value
        return Quantity(value, ALL_METRICS[name].unit, measured.reason, lambda: self._with_errors[name].own_error)

    def __getitem__(self, name: str) -> Quantity:
        """Return a metric, computed alone."""
        if name not in self._found:
            try:
                measured = measure_run(self._run, companions=0, names=[name])[name]
            except InputError:
                raise KeyError(self._unknown(name)) from None
            self._found[name] = self._number(name, measured)
        return self._found[name]

    def __getattr__(self, name: str) -> Quantity:
        """Return a metric as an attribute."""
        # notebooks and copies look for names that are no metrics
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(error.args[0]) from None

    def _unknown(self, name: str) -> str:
        known = self._names()
        hint = suggestion(name, known)
        return f"this run has no metric {name!r}; {hint}"

    def __iter__(self) -> Iterator[str]:
        return iter(self._numbers)

    def __len__(self) -> int:
        return len(self._numbers)

    def __dir__(self) -> list[str]:
        """Names for completion."""
        return sorted({*super().__dir__(), *self._names()})

    def _ipython_key_completions_(self) -> list[str]:
        return self._names()

    def _names(self) -> list[str]:
        """Return the names of the metrics; the usual ones where they can't be computed."""
        try:
            return [*self._numbers]
        except (CosimError, EquilibriumError):
            return [*COMMON_METRICS]

    def __reduce__(self) -> tuple[object, ...]:
        """Copies and pickles compute the metrics again."""
        return RunMetrics, (self._run,)

    def __repr__(self) -> str:
        """Return five lines: the first three metrics and the names of the others; `print` shows all."""
        try:
            lines = self._lines()
        except (CosimError, EquilibriumError) as error:
            return f"{self._head()}: {shorten(str(error), 200)}"
        rest = shorten(f"… {max(len(lines) - 3, 0)} more, print shows them: {', '.join([*self._numbers][3:])}", 77)
        return "\n".join([f"{self._head()}:", *lines[:3], f"  {rest}"])

    def __str__(self) -> str:
        """Return all metrics, a line each."""
        return "\n".join([f"{self._head()}:", *self._lines()])

    def _head(self) -> str:
        return f"Metrics of {self._run.scene.name}, in SI units"

    def _lines(self) -> list[str]:
        width = max(map(len, self._numbers), default=0)
        return [f"  {name:<{width}}  {value}" for name, value in self._shown().items()]

    def _shown(self) -> dict[str, str]:
        """Return name → number with unit; if errors are known already, the companion's with the digits that its error allows."""
        known: Mapping[str, Any] = self._with_errors if "_with_errors" in self.__dict__ else {}
        shown = {}
        for name, number in self._numbers.items():
            value, error = (known[name].value, known[name].error) if name in known else (float(number), None)
            text, bound = printed(value, error)
            margin = f", numerical error below {bound}" if bound else ""
            shown[name] = shorten(f"{text} {number.unit}".rstrip() + margin, 79)
        return shown

    def _repr_html_(self) -> str:
        try:
            rows = [(name, text, ALL_METRICS[name].description) for name, text in self._shown().items()]
        except (CosimError, EquilibriumError) as error:
            rows = [("", str(error), "")]
        return html_table(("metric", "value", "meaning"), rows)
