"""What `flexfmu run` prints: the metrics with their errors or the ranges of outputs, how the run went, and warnings."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.cli.console import files_sentence, print_rich
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.experiment.accuracy import rounded_up
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, DRIVE_METRICS, definition, display, display_error
from flexfmu.cosim.reports.summary import STRESS, motor_table, stress_table, title_of
from flexfmu.cosim.reports.terminal import as_terminal_table, titled_table

TEXT_WIDTH = 40
"""Characters of a text in the table of results."""


def print_summary(summary: Mapping[str, Any], choice: str, folder: Path, files: Sequence[str]) -> None:
    """What was chosen, the metrics of a complete run, the FMU's statistics, warnings, and where the files are."""
    health, metrics = summary["health"], summary["metrics"]
    parts: list[Any] = [choice] if choice else []
    parts += summary["accuracy"]["text"] if "accuracy" in summary else ()
    if health["outcome"] == "completed":
        # what the motors have to do is in summary.json, and here where the scene has motors
        shown = {
            each: value for each, value in metrics.items() if "motor" in summary["scene"] or each not in DRIVE_METRICS
        }
        proven = {each["name"] for each in summary.get("accuracy", {}).get("figures", ())}
        parts += [_metrics_table(title_of(summary), shown, summary["errors"], proven), health["errors_from"]]
    motors, links = summary.get("motors", ()), summary.get("stresses", ())
    tables = (motor_table(motors), stress_table(links, "Stress"))
    parts += [as_terminal_table(table, texts=(STRESS,)) for table in tables if table.rows]
    # how the run went
    timing, statistics = summary["timing"], ", ".join(f"{count} {name}" for name, count in health["statistics"].items())
    parts.append(
        f"{health['outcome']}: {health['end_time'] or 0.0:g} s simulated in {timing['simulate']:.3f} s "
        f"(FMU ready in {timing['build']:.3f} s)" + (f"; {statistics}" if statistics else "")
    )
    # the cycles, where a motion is repeated
    if learning := summary.get("learning"):
        errors = (1e3 * max(each["rms"]) for each in learning["tracking_errors"])
        parts.append("tracking error of the cycles, mrad RMS: " + ", ".join(f"{error:.4g}" for error in errors))
        if worst := learning.get("contraction"):
            parts.append(
                f"contraction: from cycle to cycle errors change by a factor of at most {worst['factor']:.4g}, at "
                f"{worst['frequency']:.4g} Hz and {100.0 * worst['place']:.3g} % of the path"
            )
    if late := _late(summary["delays"]):
        parts.append("late signals:\n  " + "\n  ".join(late))
    # what spoils the results
    sentences: list[str] = []
    # where an accuracy was asked for, other figures may be coarser
    if health["warnings"] and "accuracy" not in summary:
        coarse = "; ".join(
            f"{ALL_METRICS[each['metric']].label} (by {display(each['metric'], each['estimated_error'], digits=1)})"
            for each in health["warnings"]
        )
        sentences.append(f"the communication step of {health['communication_step']:g} s is too coarse for: {coarse}")
    sentences += [
        *health["large_deflections"],
        *health["counted_twice"],
        *health["beyond_tolerance"],
        *filter(None, map(health.get, ("unstable_loop", "stability", "coarse_counts"))),
    ]
    sentences += [sentence for part in (*motors, *links) for sentence in part["exceeded"]]
    parts += [Text(f"warning: {sentence}", style="yellow") for sentence in sentences]
    parts.append(files_sentence(files, folder))
    print_rich(*parts)


def _late(delays: Sequence[Mapping[str, Any]]) -> list[str]:
    """Descriptions of the connections that are late, those of both joints as one, the latest first."""
    late = [each for each in delays if each["seconds"] > 0.0 or each["average"] > 0.0]
    late.sort(key=lambda each: -float(each["average"]))
    return list(dict.fromkeys(re.sub(r"\bjoint[12]\.", "joint*.", each["description"]) for each in late))


def _metrics_table(
    title: str, metrics: Mapping[str, float | None], errors: Mapping[str, float | None], proven: Collection[str] = ()
) -> Table:
    """Metrics with a bound of their errors; the errors themselves where they are ``proven``, in two digits."""
    heads = ["Value", *(["±"] if any(error is not None for error in errors.values()) else [])]
    table = titled_table(title, "Metric", "Name", numbers=heads, stacks=True)
    for name, value in metrics.items():
        error = errors[name]
        cells = display(name, value, error=error), display_error(name, value, error)
        if error is not None and name in proven:
            cells = display(name, value, error=error / 20.0), f"{rounded_up(definition(name).displayed(error)):.2g}"
        table.add_row(ALL_METRICS[name].label, name, *cells[: len(heads)])
    return table


def print_ssp_summary(summary: Mapping[str, Any], recording: Recording, folder: Path, files: Sequence[str]) -> None:
    """The outputs' ranges of an SSP file's run, how it ended, and where the files are."""
    ended = f"{summary['end_time'] or 0.0:g} s in steps of {summary['communication_step']:g} s"
    parts: list[RenderableType] = [_ranges(summary["system"], recording), f"{summary['message']}: {ended}"]
    if summary["ignored_parameters"]:
        names = ", ".join(summary["ignored_parameters"])
        parts.append(Text(f"warning: parameters that fit no variable were ignored: {names}", style="yellow"))
    parts += [Text(f"warning: {remark}", style="yellow") for remark in summary["remarks"]]
    print_rich(*parts, files_sentence(files, folder))


def _ranges(title: str, recording: Recording) -> Table:
    """Smallest, largest and last value of every output; of a text the last alone."""
    table = titled_table(title, "Output", numbers=("Smallest", "Largest", "Last"))
    for name, column in recording.columns.items():
        if column.values.size and column.texts is not None:
            # texts have no order; long ones and line breaks stay in results.csv
            last = " ".join(column.text_at(-1).split())
            table.add_row(name, "", "", f'"{last[:TEXT_WIDTH]}{"..." if len(last) > TEXT_WIDTH else ""}"')
        elif column.values.size:
            values = column.values.min(), column.values.max(), column.values[-1]
            table.add_row(f"{name} [{shown_unit(column.unit) or '-'}]", *(f"{value:.6g}" for value in values))
    return table
