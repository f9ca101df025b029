"""`flexfmu run` of a scene: simulate it and write its results, summary and report."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from flexfmu.cosim.cli.console import (
    FAILURE,
    check_formats,
    load_changed,
    print_text,
    progress,
    show_note,
    usual_folder,
    write_results,
)
from flexfmu.cosim.engine.errors import LoopWarning, ResultsError
from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.cosim.engine.master.simulation_loop import Progress
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.prepared_scene import Run, run_scene
from flexfmu.cosim.experiment.run_options import RunOptions
from flexfmu.cosim.metrics.metric_table import COMMON_METRICS
from flexfmu.cosim.metrics.metrics import measure, settings_for, with_errors
from flexfmu.cosim.metrics.recorded_solution import Settings
from flexfmu.cosim.reports.summary import summarise
from flexfmu.cosim.reports.text import to_json
from flexfmu.model.scene.errors import EquilibriumError


def run_command(
    source: str,
    out: Path | None,
    as_json: bool,
    options: RunOptions,
    *,
    companions: int = 1,
    has_report: bool = True,
    recorded: tuple[list[str] | None, float | None, int | None] = (None, None, None),
    formats: Sequence[str] = ("csv",),
    changes: Sequence[str] | None = None,
) -> int:
    """Simulate, write, print; the exit status.

    What was recorded before a failure is written too.

    Args:
        source: file or name of the scene.
        out: folder of the results; None for the usual one.
        as_json: whether the summary is printed as JSON.
        options: of the run.
        companions: how many more precise runs the errors are taken from.
        has_report: whether report.html is drawn; otherwise that of an earlier run is removed.
        recorded: names, interval [s] and derivatives of the recorded signals; None for the scene's keys.
        formats: of the recorded signals, of `flexfmu.cosim.engine.results.FORMATS`.
        changes: keys of the scene that change, ``KEY=VALUE``.
    """
    # formats and folder come first: no run is lost because it can't be written
    check_formats(formats)
    scene = load_changed(source, changes)
    folder = OutputFolder(out or usual_folder(scene.name, changes))
    folder.prepare()
    with progress() as show:
        if scene.effects.select is not None or scene.learners:
            from flexfmu.cosim.design.effects.choice import resolved

            scene = resolved(scene, show)
        show("planning the motion, building the FMU", None)
        (names, every, order), section = recorded, scene.cosimulation
        order = section.record_order if order is None else order
        record = Selection(names or section.record, order, section.record_step if every is None else every)
        options["record"] = record
        options["progress"] = partial(show, "simulating")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LoopWarning)  # which the summary has
            run = run_scene(scene, **options)
        # the recording first, whatever becomes of metrics and plots
        show("writing the results", None)
        files = write_results(folder, run.recording, formats, run.about)
        progressing = partial(show, "estimating the errors")
        # metrics and report are of all signals with two derivatives
        is_whole = record.names is None and record.order == EVERYTHING.order
        has_report = has_report and is_whole
        settings, measurements, problem = _measure(run, companions if is_whole else None, progressing)
        summary = summarise(run, measurements)
        if changes:
            summary["changes"] = [*changes]
        if scene.controller:
            from flexfmu.cosim.design.margins.loop_warnings import loop_sentences

            summary["health"] |= loop_sentences(run)
        if "learning" in summary and scene.learners:
            from flexfmu.cosim.design.learning import contraction_of

            contraction = contraction_of(scene)
            summary["learning"]["contraction"] = None if contraction is None else asdict(contraction)
        folder.write("summary.json", to_json(summary))
        if has_report:
            show("drawing the report", None)
            folder.write("report.html", _report(run, settings, summary))
        else:
            folder.remove("report.html")
    # standard output
    if as_json:
        print_text(to_json(summary))
    else:
        from flexfmu.cosim.cli.run_summary import print_summary
        from flexfmu.model.choice_text import choice_sentence

        print_summary(
            summary,
            choice_sentence(scene),
            folder.path,
            [*files, "summary.json", *(["report.html"] if has_report else [])],
        )
    if problem is not None:
        show_note(f"{problem}; what was recorded is in {folder.path}")
        return FAILURE
    return 0


def _measure(
    run: Run, companions: int | None, progress: Progress
) -> tuple[Settings | None, Mapping[str, Metric], str | None]:
    """What the metrics depend on, the metrics, and why there are none where that is so; without ``companions`` none are wanted."""
    none = dict.fromkeys(COMMON_METRICS, Metric(None))
    if companions is None or not run.completed:
        return None, none, run.message if run.outcome.is_failure else None
    try:
        settings = settings_for(run)
        return settings, with_errors(run, measure(run.recording, settings), settings, companions, progress), None
    except (EquilibriumError, ResultsError) as error:
        return None, none, str(error)


def _report(run: Run, settings: Settings | None, summary: Mapping[str, Any]) -> str:
    from flexfmu.cosim.reports.plots import draw_plots
    from flexfmu.cosim.reports.report import render_report

    rest = settings.end_equilibrium if settings is not None and settings.dwell else None
    return render_report(summary, draw_plots(run, rest))
