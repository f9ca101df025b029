"""Runs side by side, and what a measurement differs from them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexfmu.cosim.design.identification.result import fitted_plots
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import to_json, write_whole
from flexfmu.cosim.engine.measured import (
    Delay,
    Difference,
    Log,
    Mapped,
    Pair,
    TimedValues,
    correlation,
    difference,
    estimate_delay,
    read_log,
)
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.showing import Rows, few_lines, html_table, shown_unit
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, LOOP_FIGURES, definition
from flexfmu.cosim.reports.chart import INK, PALETTE
from flexfmu.cosim.reports.comparison import (
    BAND_METRICS,
    ComparedRun,
    compared_plots,
    comparison_page,
    loop_tables,
    metrics_table,
)
from flexfmu.cosim.reports.page import Plot, Table

POORLY = 0.5
"""Correlation below which measurement and simulation hardly look alike."""


if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Measured:
    """A measurement, aligned in time with the first run.

    Attributes:
        name: short name.
        recording: the measured signals in SI units, over the measurement's own time.
        delay: time of an event in the measurement minus its time in the simulation.
        differences: name of a run → name of a signal → measured minus simulated.
    """

    name: str
    recording: Recording = field(repr=False)
    delay: Delay
    differences: Mapping[str, Mapping[str, Difference]] = field(repr=False)


@dataclass(frozen=True, repr=False)
class Comparison(Rows):
    """Runs side by side.

    Attributes:
        runs: the runs; `metrics` and `recording` of each.
        measured: the measurement; None without.
    """

    row_name = "metric"

    runs: tuple[ComparedRun, ...]
    measured: Measured | None = None

    def as_data(self) -> dict[str, Any]:
        """Return plain data in SI units, the content of ``comparison.json``.

        Keys:
            runs: name, duration [s], metrics and errors of each run; loop (margins and cpu_time [s]) of a scene that was run, failure
                (a message) where it failed, and payload_band (masses [kg], worst metrics, failures) where a band was compared.
            measured: name, delay, delay_error [s], correlation, and under signals for each run and signal: rms, mean, largest
                (magnitude), relative (rms to the measured range), unit, samples; only with a measurement.
        """
        runs = []
        for run in self.runs:
            found: dict[str, Any] = {"name": run.name, "duration": run.duration}
            found["metrics"] = {name: each.value for name, each in run.metrics.items()}
            found["errors"] = {name: each.error for name, each in run.metrics.items()}
            if run.loop:
                found["loop"] = {name: each.value for name, each in run.loop.items()}
            if run.failure:
                found["failure"] = run.failure
            if run.band is not None:
                found["payload_band"] = {
                    "masses": list(run.band.masses),
                    "worst": {name: each.value for name, each in run.band.worst.items()},
                    "failures": {f"{mass:g}": message for mass, message in run.band.failures.items()},
                }
            runs.append(found)
        if self.measured is None:
            return {"runs": runs}
        delay = self.measured.delay
        signals = {
            run: {
                name: {
                    "rms": each.root_mean_square,
                    **{key: getattr(each, key) for key in ("mean", "largest", "relative")},
                    "unit": self.measured.recording[name].unit,
                    "samples": each.time.size,
                }
                for name, each in found.items()
            }
            for run, found in self.measured.differences.items()
        }
        measured = {
            "name": self.measured.name,
            "delay": delay.seconds,
            "delay_error": delay.error if np.isfinite(delay.error) else None,
            "correlation": delay.correlation,
            "signals": signals,
        }
        return {"runs": runs, "measured": measured}

    def rows(self) -> list[dict[str, Any]]:
        """The metrics, a row each with the value of every run, NaN for none.

        Below them ``cpu_time`` and margins of scenes that were run, and ``worst.<metric>`` over a band of payloads.
        """
        groups: tuple[tuple[str, Iterable[str], list[Mapping[str, Metric]]], ...] = (
            ("", ALL_METRICS, [run.metrics for run in self.runs]),
            ("", LOOP_FIGURES, [run.loop for run in self.runs]),
            ("worst.", BAND_METRICS, [run.band.worst if run.band else {} for run in self.runs]),
        )
        found = []
        for prefix, names, of_runs in groups:
            for name in (each for each in names if any(each in metrics for metrics in of_runs)):
                values = [metrics.get(name, Metric(None)).value for metrics in of_runs]
                row = {run.name: nan if value is None else value for run, value in zip(self.runs, values, strict=True)}
                found.append({"metric": f"{prefix}{name}", **row})
        return found

    def row_units(self) -> Mapping[str, str]:
        """Metric → unit."""
        units = {row["metric"]: row["metric"].removeprefix("worst.") for row in self.rows()}
        return {row: definition(name).unit for row, name in units.items()}

    def page(self, *, live: bool = False) -> str:
        """Return the page of the comparison as HTML: metrics, signals over each other, spectra.

        Args:
            live: whether the page simulates the runs side by side, with common sliders; it needs ziglang. Results that were read stay as
                recorded.
        """
        page = comparison_page(self.runs, self.tables(), self.plots())
        if live:
            from flexfmu.cosim.exchange.live import side_by_side  # which few comparisons need

            page = side_by_side(page, self.runs)
        return page.html

    def write(self, folder: str | os.PathLike[str], *, live: bool = False) -> Path:
        """Write comparison.html and comparison.json into a folder; return its path.

        Args:
            folder: where to.
            live: whether the page simulates, as for `page`.

        Raises:
            ResultsError: a file can't be written, with the system's reason.
            MissingCompilerError: there is no ziglang, which compiles the runs for the page.
        """
        target = Path(folder)
        write_whole(target / "comparison.html", self.page(live=live))
        write_whole(target / "comparison.json", to_json(self.as_data()))
        return target

    def __repr__(self) -> str:
        """Return at most five lines: the runs, and the differences of a measurement."""
        head = f"Comparison of {', '.join(run.name for run in self.runs)}, {len(metrics_table(self.runs).rows)} metrics"
        if self.measured is None:
            return head
        first = self.measured.differences[self.runs[0].name]
        items = [f"{name}: {each.root_mean_square:.4g} RMS" for name, each in first.items()]
        return few_lines(f"{head}; {self.measured.name} is {delay_text(self.measured.delay)}:", items)

    def tables(self) -> list[Table]:
        """Return the tables of the page: metrics, loops, and the differences of a measurement; those that have rows."""
        measured = []
        if each := self.measured:
            note = f"{each.name} is {delay_text(each.delay)}. In the last column: RMS relative to the measured range."
            measured = [difference_table(f"{each.name} minus simulation", each.recording, each.differences, note)]
        found = [table for table in (metrics_table(self.runs), *loop_tables(self.runs), *measured) if table.rows]
        return found or [table for run in self.runs[1:] if (table := _signals_table(run, self.runs[0])).rows]

    def html_tables(self) -> str:
        """The tables of a notebook."""
        return "".join(html_table(table.header, table.rows) for table in self.tables())

    def plot(self) -> Figure:
        """Signals of all runs over each other, and beside those of the measurement, as on the page."""
        from flexfmu.cosim.reports.figure_style import figure_of

        return figure_of(self.plots(), columns=2)

    def plots(self) -> list[Plot]:
        """The plots of the page: signals of a measurement beside the simulated ones, then those of all runs and their spectra."""
        measured = [] if self.measured is None else _measured_plots(self.runs, self.measured)
        return [*measured, *compared_plots(self.runs)]


def compare_runs(
    runs: Sequence[ComparedRun],
    log: Log | None = None,
    mapping: Mapping[str, Mapped] | None = None,
    delay: float | None = None,
    *,
    strict: bool = False,
) -> Comparison:
    """Compare runs, and a measurement with each of them.

    Args:
        runs: at least one.
        log: a measurement for `read_log`; None without.
        mapping: name of a column of the measurement → what it is.
        delay: of the measurement [s]; None to estimate it from the first run.
        strict: as for `read_log`.

    Raises:
        ResultsError: the file can't be read.
        InputError: nothing that was measured is simulated, or the delay can't be estimated.
    """
    if log is None:
        if mapping or delay is not None:
            raise InputError("a mapping of columns or a delay goes with a measurement")
        return Comparison(tuple(runs))
    units = {name: column.unit for run in reversed(runs) for name, column in run.recording.columns.items()}
    recording = read_log(log, mapping or {}, units, strict=strict)
    name = Path(log).stem if isinstance(log, str | Path) else "measured"
    # the delay from the first run, which all others get: it belongs to the measurement's clock
    measured = {each: _sampled(recording, each) for each in recording.columns}
    simulated = [
        {each: _sampled(run.recording, each) for each in measured if each in run.recording.columns} for run in runs
    ]
    pairs: list[Pair] = [(measured[each], simulated[0][each]) for each in simulated[0]]
    if not pairs:
        raise InputError(f"no signal of {name} was recorded in {runs[0].name}: {', '.join(measured)}")
    found = estimate_delay(pairs) if delay is None else Delay(delay, 0.0, correlation(pairs, delay))
    differing = {
        run.name: {signal: difference(measured[signal], each, found.seconds) for signal, each in signals.items()}
        for run, signals in zip(runs, simulated, strict=True)
    }
    return Comparison(tuple(runs), Measured(name, recording, found, differing))


def delay_text(delay: Delay) -> str:
    """Return the delay in words, with its error and a warning where the signals hardly look alike."""
    factor, unit, digits = (1.0, "s", 7) if abs(delay.seconds) >= 1.0 else (1e3, "ms", 4)
    what = f"{factor * abs(delay.seconds):.{digits}f} {unit} {'late' if delay.seconds >= 0.0 else 'early'}"
    margin = f" (± {factor * delay.error:.1g} {unit})" if delay.error else ""
    return f"{what}{margin}, correlation {delay.correlation:.4f}"


def difference_table(
    title: str, recording: Recording, differences: Mapping[str, Mapping[str, Difference]], note: str
) -> Table:
    """Return RMS, mean and largest difference of each of a recording's signals from each run."""
    rows = [
        [
            signal,
            run,
            *(f"{value:.4g} {unit}".rstrip() for value in (each.root_mean_square, each.mean, each.largest)),
            "–" if each.relative is None else f"{100.0 * each.relative:.3g} %",
        ]
        for run, signals in differences.items()
        for signal, each in signals.items()
        for unit in [shown_unit(recording[signal].unit)]
    ]
    return Table(title, ["Signal", "Run", "RMS", "Mean", "Largest", "Range"], rows, note)


def _signals_table(run: ComparedRun, first: ComparedRun) -> Table:
    """The differences of signals that two runs have in common, which files without metrics have alone."""
    found = {}
    for name in (each for each in run.recording.columns if each in first.recording.columns):
        if run.recording[name].texts is None and first.recording[name].texts is None:
            own, other = _sampled(run.recording, name), _sampled(first.recording, name)
            time = own.time[(own.time >= other.time[0]) & (own.time <= other.time[-1])]
            if time.size and np.ptp(time) > 0.0:
                found[name] = Difference(time, own.at(time), other.at(time))
    note = "In the last column: RMS relative to the signal's range."
    return difference_table(f"{run.name} minus {first.name}", run.recording, {first.name: found}, note)


def _sampled(recording: Recording, name: str) -> TimedValues:
    """Return the finite samples of a signal."""
    values = recording[name].values
    known = np.isfinite(values)
    if not known.any():
        raise InputError(f"signal {name!r} has no values")
    return TimedValues(recording.time[known], values[known])


def _measured_plots(runs: Sequence[ComparedRun], measured: Measured) -> Iterator[Plot]:
    """Yield measured and simulated values, and their difference, of each signal, and its spectra."""
    text = f"{measured.name}, {delay_text(measured.delay)}, and simulated."
    for number, name in enumerate(measured.recording.columns):
        compared = [(run.name, measured.differences[run.name].get(name)) for run in runs]
        coloured = [
            (run, each, PALETTE[i % len(PALETTE)]) for i, (run, each) in enumerate(compared) if each is not None
        ]
        if coloured:
            lines = [(coloured[0][1].time, coloured[0][1].measured, measured.name, INK)]
            lines += [(each.time, each.simulated, run, colour) for run, each, colour in coloured]
            differing = [(each.time, each.values, run, colour) for run, each, colour in coloured]
            unit, groups = shown_unit(measured.recording[name].unit), {name: lines, "difference": differing}
            yield from fitted_plots(f"measured-{number}", name, text, unit, groups, name)
