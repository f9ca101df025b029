"""`flexfmu compare`: runs, scenes and a measurement side by side."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flexfmu.cosim.cli.console import print_text, progress, rich_output
from flexfmu.cosim.cli.options import JsonOption

if TYPE_CHECKING:
    from rich.table import Table

    from flexfmu.cosim.reports.comparison import ComparedRun
    from flexfmu.cosim.studies.compare.comparison import Comparison, Measured


def compare(
    runs: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN...",
            help="A folder of results, a results file (.csv, .parquet, .mat), or a scene, which is run now.",
            show_default=False,
        ),
    ],
    measured: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG.csv",
            help="A measurement: a CSV file with a header and a column `time`. Columns named like signals are compared.",
            show_default=False,
        ),
    ] = None,
    mapping: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="COLUMN=SIGNAL",
            help="What a measured column is, with a factor or a unit and an offset if needed: tau1=joint1.torque*1e-3, "
            "phi=joint1.position*deg+0.5, t=time*ms. May be repeated.",
            show_default=False,
        ),
    ] = None,
    delay: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Time of an event in the measurement minus that in the simulation. Default: estimated by correlation.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Write comparison.html and comparison.json there. Default: nowhere.", show_default=False
        ),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Compare runs with each other and with a measurement: metrics side by side, signals over each other, spectra.

    Differences are relative to the first run. A measurement is aligned in time with it; RMS, mean and largest difference of each
    signal are those over the time that both have.
    """
    from flexfmu.cosim.engine.files import OutputFolder
    from flexfmu.cosim.reports.text import to_json
    from flexfmu.cosim.studies.compare.comparison import compare_runs
    from flexfmu.cosim.studies.compare.measured import parse_mapping
    from flexfmu.cosim.studies.compare.sources import compared_runs

    # what can be wrong is checked before anything is simulated
    meaning = dict(map(parse_mapping, mapping or ()))
    if out is not None:
        OutputFolder(out).prepare()
    with progress() as show:
        found = compare_runs(compared_runs(runs, show), measured, meaning, delay)
    if out is not None:
        found.write(out)
    if json:
        print_text(to_json(found.as_data()))
    else:
        _print(found, out)
    return 0


def _print(found: Comparison, out: Path | None) -> None:
    """The metrics, the differences of a measurement, and where the page is."""
    from flexfmu.cosim.studies.compare.comparison import POORLY, delay_text

    with rich_output() as console:
        for table in _metrics_tables(found, console.width):
            console.print(table)
        if found.measured is not None:
            for table in _difference_tables(found.measured):
                console.print(table)
            console.print(f"{found.measured.name} is {delay_text(found.measured.delay)}")
            if found.measured.delay.correlation < POORLY:
                console.print(
                    "warning: measurement and simulation hardly look alike; check --map, signs and --delay",
                    style="yellow",
                )
        if out is not None:
            console.print(f"comparison.html and comparison.json are in {out}", soft_wrap=True)


LABEL, VALUE = 38, 19
"""Columns of the terminal that a metric's name and unit take, and a run's value."""


def _metrics_tables(found: Comparison, width: int) -> Iterator[Table]:
    """Yield the metrics of as many runs as fit beside each other, with the first one wherever two do."""
    from flexfmu.cosim.metrics.metric_table import ALL_METRICS

    names, runs = found.metric_names, [run for run in found.runs if run.metrics]
    if not names:
        return
    first, *others = runs
    # where there is no room for two, each has a table of its own
    beside = (width - LABEL) // VALUE - 1
    for begin in range(0, max(len(others), 1) if beside > 0 else len(runs), max(beside, 1)):
        shown = [first, *others[begin : begin + beside]] if beside > 0 else [runs[begin]]
        table = _table("Metrics" if begin == 0 else "", "Metric", "Unit", *(run.name for run in shown))
        for name in names:
            info = ALL_METRICS[name]
            table.add_row(info.label, info.display_unit, *(_cell(name, run, first) for run in shown))
        yield table


def _table(title: str, *headings: str) -> Table:
    """An empty table whose first column wraps and whose numbers don't."""
    from rich.table import Column

    from flexfmu.cosim.reports.terminal import titled_table

    numbers = (Column(each, justify="right", no_wrap=True, overflow="fold") for each in headings[1:])
    return titled_table(title, Column(headings[0], overflow="fold"), *numbers)


def _cell(name: str, run: ComparedRun, first: ComparedRun) -> str:
    """A metric's value, with its difference from the first run's in percent."""
    from flexfmu.cosim.metrics.metric_table import ALL_METRICS, Measurement

    none = Measurement(None)
    value, base = run.metrics.get(name, none).value, first.metrics.get(name, none).value
    if value is None:
        return "–"
    text = f"{value * ALL_METRICS[name].display_factor:.5g}"
    return text if run is first or not base else f"{text} ({100.0 * (value / base - 1.0):+.3g} %)"


def _difference_tables(measured: Measured) -> Iterator[Table]:
    """Yield RMS, mean and largest difference of each signal from each run; "of range" is RMS to the measured range."""
    from rich.text import Text

    for run, signals in measured.differences.items():
        table = _table(f"{measured.name} minus {run}", "Signal", "RMS", "Mean", "Largest", "of range")
        for name, each in signals.items():
            figures = (each.root_mean_square, each.mean, each.largest)
            share = "–" if each.relative is None else f"{100.0 * each.relative:.3g} %"
            unit = measured.recording[name].unit
            # brackets are no markup here
            label = Text(f"{name} [{unit}]" if unit else name)
            table.add_row(label, *(f"{value:.4g}" for value in figures), share)
        yield table
