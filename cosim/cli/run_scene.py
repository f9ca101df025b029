"""`flexfmu run` of a scene: simulate it and write its results, summary and report."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import RenderableType
from rich.table import Column, Table
from rich.text import Text

from flexfmu.cosim.cli.console import FAILURE, print_rich, print_text, progress, show_note
from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.files import RESULTS, OutputFolder
from flexfmu.cosim.engine.master.simulation_loop import Progress
from flexfmu.cosim.experiment.prepared_scene import Run, run_scene
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, METRICS, Measurement, display
from flexfmu.cosim.metrics.metrics import Settings, measure, settings_for, with_errors
from flexfmu.cosim.reports.summary import summarise
from flexfmu.cosim.reports.text import titled_table, to_json
from flexfmu.model.choice_text import choice_sentence
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.file import load_scene


def run_command(
    source: str,
    out: Path | None,
    as_json: bool,
    step: float | None = None,
    isolate: bool | None = None,
    companions: int = 1,
) -> int:
    """Simulate, write, print; the exit status.

    What was recorded before a failure is written too. ``companions``: how many more precise runs the errors are taken from.
    """
    # the folder is made first: no run is lost because it can't be written
    scene = load_scene(source)
    folder = OutputFolder(out or RESULTS / scene.name)
    folder.prepare()
    with progress() as show:
        if scene.effects.select is not None:
            from flexfmu.cosim.choices.effects.choice import resolved

            scene = resolved(scene, show)
        show("planning the motion, building the FMU", None)
        run = run_scene(
            scene, communication_step=step, progress=lambda fraction: show("simulating", fraction), isolate=isolate
        )
        # the recording first, whatever becomes of metrics and plots
        show("writing the results", None)
        run.recording.write_csv(folder.path / "results.csv")
        progressing = partial(show, "estimating the errors")
        settings, measurements, problem = _measure(run, companions, progressing)
        summary = summarise(run, measurements)
        folder.write("summary.json", to_json(summary))
        show("drawing the report", None)
        folder.write("report.html", _report(run, settings, summary))
    # standard output
    if as_json:
        print_text(to_json(summary))
    else:
        _print_summary(summary, choice_sentence(scene), folder.path)
    if problem is not None:
        show_note(f"{problem}; what was recorded is in {folder.path}")
        return FAILURE
    return 0


def _measure(
    run: Run, companions: int, progress: Progress
) -> tuple[Settings | None, Mapping[str, Measurement], str | None]:
    """What the metrics depend on, the metrics, and why there are none where that is so."""
    none = dict.fromkeys(METRICS, Measurement(None))
    if not run.completed:
        return None, none, run.message if run.outcome.is_failure else None
    try:
        settings = settings_for(run)
        return settings, with_errors(run, measure(run.recording, settings), settings, companions, progress), None
    except (EquilibriumError, ResultsError) as error:
        return None, none, str(error)


def _report(run: Run, settings: Settings | None, summary: Mapping[str, Any]) -> str:
    from flexfmu.cosim.reports.plots import draw_plots
    from flexfmu.cosim.reports.report import render_report

    return render_report(summary, draw_plots(run, None if settings is None else settings.end_equilibrium))


def _print_summary(summary: Mapping[str, Any], choice: str, folder: Path) -> None:
    """What was chosen, the metrics of a complete run, the FMU's statistics, warnings, and where the files are."""
    name, health, metrics = summary["scene"]["name"], summary["health"], summary["metrics"]
    parts: list[RenderableType] = [Text(choice)] if choice else []
    if health["outcome"] == "completed":
        parts += [_metrics_table(name, metrics, summary["errors"]), Text(health["errors_from"])]
    # how the run went
    parts.append(Text(_health_line(health, summary["timing"])))
    parts += _learning_line(summary.get("learning"))
    late = [delay for delay in summary["delays"] if delay["seconds"] > 0.0 or delay["average"] > 0.0]
    if late:
        parts.append(Text("late: " + "; ".join(delay["description"] for delay in late)))
    # what spoils the results
    if health["warnings"]:
        parts.append(Text(_warning_line(health), style="yellow"))
    sentences = [*health["large_deflections"], *filter(None, [health["unstable_loop"]])]
    parts += [Text(f"warning: {sentence}", style="yellow") for sentence in sentences]
    parts.append(Text(f"results.csv, summary.json and report.html are in {folder}"))
    print_rich(*parts)


def _metrics_table(title: str, metrics: Mapping[str, float | None], errors: Mapping[str, float | None]) -> Table:
    table = titled_table(title, "Metric", Column("Value", justify="right"))
    for name, value in metrics.items():
        table.add_row(ALL_METRICS[name].label, display(name, value, error=errors[name]))
    return table


def _health_line(health: Mapping[str, Any], timing: Mapping[str, float]) -> str:
    statistics = ", ".join(f"{count} {name}" for name, count in health["statistics"].items())
    return (
        f"{health['outcome']}: {health['end_time'] or 0.0:g} s simulated in {timing['simulate']:.3f} s "
        f"(FMU ready in {timing['build']:.3f} s)" + (f"; {statistics}" if statistics else "")
    )


def _learning_line(learning: Mapping[str, Any] | None) -> list[RenderableType]:
    """The tracking error of the cycles, where a motion is repeated."""
    if learning is None:
        return []
    errors = [1e3 * max(each["rms"]) for each in learning["tracking_errors"]]
    return [Text("tracking error of the cycles, mrad RMS: " + ", ".join(f"{error:.4g}" for error in errors))]


def _warning_line(health: Mapping[str, Any]) -> str:
    """All metrics for which the communication step is too coarse, each with its estimated error."""
    coarse = "; ".join(
        f"{ALL_METRICS[warning['metric']].label} ± {display(warning['metric'], warning['estimated_error'], digits=1)}"
        for warning in health["warnings"]
    )
    return f"warning: the communication step of {health['communication_step']:g} s is too coarse for: {coarse}"
