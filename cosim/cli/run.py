"""`flexfmu run`: co-simulate a scene or an SSP file."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexfmu.cosim.cli import console
from flexfmu.cosim.engine.errors import InputError, LoopWarning, ResultsError
from flexfmu.cosim.engine.files import RESULTS, file_digest, to_json

if TYPE_CHECKING:
    from flexfmu.cosim.experiment.run_options import RunOptions


def run(
    scene: str,
    out: Path | None = None,
    step: float | None = None,
    stop_time: float | None = None,
    ssd: str | None = None,
    output_order: Annotated[int | None, typer.Option(min=0)] = None,
    isolate: bool | None = None,
    sandbox: bool = False,
    verify: bool | None = None,
    report: bool | None = None,
    live: bool = False,
    record: list[str] | None = None,
    record_step: float | None = None,
    record_order: Annotated[int | None, typer.Option(min=0, max=2)] = None,
    formats: list[str] | None = None,
    yes: bool = False,
    accuracy: list[str] | None = None,
    output: Path | None = None,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Co-simulate a scene: writes results.csv, summary.json and report.html, prints the metrics.

    The FMU is built first unless it is in the cache. A companion run with shorter communication steps and a tighter
    tolerance gives the errors of the metrics; --no-verify saves it. An SSP file, ours or not, gives results.csv and summary.json.

    Args:
        scene (SCENE): A scene file (TOML), the name of a shipped scene: barnard2012-6kg, barnard2012-0.1kg, starter; or an SSP file.
        out (DIR): Folder of the results. Default: results/<name of the scene>.
        step (SECONDS): Communication step. Default: what the scene or file says.
        stop_time (SECONDS): End of an SSP file's run. Default: what the file says, or the FMUs in it.
        ssd (NAME): System of an SSP file that holds several. Default: SystemStructure.ssd.
        output_order (N): Highest output derivative that FMUs of an SSP file are asked for, 0 for none. Default: what they give.
        isolate: Simulate in a child process, so that a slave that crashes, exits or hangs ends only the run. Default: what the
            scene says, or where other tools' FMUs or Python slaves take part.
        verify: Verify the errors of the metrics by a second companion run. Default: take them from one.
        report: Draw report.html. Default: draw it, but with --json don't.
        live: Let report.html simulate: sliders change payload, stiffness, gains and more, and everything is drawn anew. It needs ziglang.
            Default: report.html shows the run alone.
        record (SIGNAL): Record this signal alone; may be repeated. Default: what the scene says, or all.
        record_step (SECONDS): Interval of the recorded instants. Default: what the scene says, or every communication point.
        record_order (N): Number of recorded derivatives. Default: what the scene says, or 2.
        formats (--format NAME): Format of the recorded signals: csv, parquet, mat (MATLAB) or mcap (Foxglove, PlotJuggler); may
            be repeated. Default: csv.
        yes: Run however large the results are. Default: refuse more than 2 GB, companion included.
        accuracy (METRIC=VALUE): Largest error of this metric, of model and numerics together: relative, peak_torque_1=1e-3 or 0.1%, or
            absolute, end_position_error='1 um'; may be repeated. Effects, communication step, integrator and tolerance are chosen
            for it. Default: those of the scene.
        output (-o, --output FILE.toml): Write the scene with the chosen settings here. Default: nowhere.
    """
    from zipfile import is_zipfile

    # options that go with the other kind of file
    is_ssp = scene.lower().endswith(".ssp") or (os.path.isfile(scene) and is_zipfile(scene))
    wrong: dict[str, Any] = {"--live is about report.html: leave out --no-report": live and report is False}
    if is_ssp:
        recorded = bool(record) or record_step is not None or record_order is not None
        wrong |= {
            "--report and --live go with a scene; an SSP file has no report": bool(report) or live,
            "--record, --record-step and --record-order go with a scene": recorded,
            f"--set {(settings or [''])[0]} goes with a scene; parameters of an SSP file are in the file": settings
            or None,
            "--accuracy and --output go with a scene": bool(accuracy) or output is not None,
        }
    else:
        wrong |= {
            "--stop-time goes with an SSP file; a scene ends with its motion and `trajectory.dwell`": stop_time,
            "--ssd goes with an SSP file; a scene is one system": ssd,
            "--output-order goes with an SSP file; in a scene each FMU has its own `output_order`": output_order,
        }
    for fault, value in wrong.items():
        if value not in (None, False):
            raise InputError(fault)
    if sandbox:
        from flexfmu.cosim.cli.sandbox import run_in_sandbox

        name = Path(scene).stem if is_ssp else "" if out else console.scene_name(scene, settings)
        run_in_sandbox(out or console.usual_folder(name, settings))
    # formats and folder come first: no run is lost because it can't be written
    from flexfmu.cosim.engine.formats import check_format

    written = tuple(dict.fromkeys(formats or ("csv",)))
    for each in written:
        check_format(each)
    if is_ssp:
        return _run_ssp(Path(scene), out, (stop_time, step, ssd, output_order), isolate, written, json)
    from flexfmu.cosim.engine.results import EVERYTHING, Selection
    from flexfmu.cosim.experiment.metric import Metric
    from flexfmu.cosim.many.prepared_scene import run_scene
    from flexfmu.cosim.metrics.metric_table import COMMON_METRICS
    from flexfmu.cosim.metrics.metrics import measure, settings_for, with_errors
    from flexfmu.cosim.reports.summary import summarise
    from flexfmu.model.scene.errors import EquilibriumError

    console.end_loading()
    if live:
        console.check_page_compiler()
    console.check_scene_file(output)
    robot, answer = console.load_changed(scene, settings), None
    if accuracy:
        from flexfmu.cosim.experiment.accuracy import asked_of

        robot = robot.replace({"accuracy": asked_of(accuracy)})
    if output is not None and not robot.accuracy:
        raise InputError("--output writes settings that were chosen for an accuracy: add --accuracy METRIC=VALUE")
    if robot.accuracy and step is not None:
        raise InputError("--accuracy chooses the communication step: leave out --step")
    folder = console.prepared_folder(out or console.usual_folder(robot.name, settings))
    with console.progress() as show:
        if robot.is_open or robot.learners:
            from flexfmu.cosim.design.effects.choice import resolved_with_answer

            robot, answer = resolved_with_answer(robot, show)
        if output is not None and answer is not None:
            from flexfmu.cosim.design.scene_files import changed_document
            from flexfmu.cosim.engine.files import write_whole
            from flexfmu.model.scene.keys import parse_setting

            document = changed_document(scene, output, {**dict(map(parse_setting, settings or ())), **answer.changes})
            document.pop("accuracy", None)
            wishes = ", ".join(f"{each.name} = {each.asked}" for each in answer.figures)
            text = document.as_string()
            # a first line for editors, which names the schema, stays first
            start = text.index("\n") + 1 if text.startswith("#:") else 0
            write_whole(output, f"{text[:start]}# settings chosen for {wishes}\n{text[start:]}")
        show("planning the motion, building the FMU", None)
        section = robot.cosimulation
        every = section.record_step if record_step is None else record_step
        selection = Selection(
            record or section.record, section.record_order if record_order is None else record_order, every
        )
        options: RunOptions = {"communication_step": step, "isolate": isolate, "accept_size": yes}
        options |= {"record": selection, "progress": partial(show, "simulating")}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LoopWarning)  # which the summary has
            found = replace(run_scene(robot, **options), accuracy=answer)
        # the recording first, whatever becomes of metrics and plots
        show("writing the results", None)
        files = console.write_results(folder, found.recording, written, found.about)
        # metrics and report are of all signals with two derivatives
        is_whole = selection.names is None and selection.order == EVERYTHING.order
        measurements: Mapping[str, Metric] = dict.fromkeys(COMMON_METRICS, Metric(None))
        basis = None
        problem = found.message if found.outcome.is_failure else None
        if is_whole and found.completed:
            try:
                basis = settings_for(found)
                own, companions = measure(found.recording, basis), 1 if verify is None else 2 * verify
                measurements = with_errors(found, own, basis, companions, partial(show, "estimating the errors"))
            except (EquilibriumError, ResultsError) as error:
                basis, problem = None, str(error)
        summary = summarise(found, measurements)
        summary["results"] = {name: file_digest(folder.path / name) for name in files}
        if settings:
            summary["changes"] = [*settings]
        if robot.controller:
            from flexfmu.cosim.design.margins.loop_warnings import loop_sentences

            summary["health"] |= loop_sentences(found)
        if "learning" in summary and robot.learners:
            from flexfmu.cosim.design.learning import contraction_of

            contraction = contraction_of(robot)
            summary["learning"]["contraction"] = None if contraction is None else asdict(contraction)
        folder.write("summary.json", to_json(summary))
        files.append("summary.json")
        if is_whole and (live or (not json if report is None else report)):
            show("drawing the report", None)
            rest = basis.end_equilibrium if basis is not None and basis.dwell else None
            if live:
                from flexfmu.cosim.exchange.live import live_report

                page = live_report(found, summary, rest)
                for reason in page.live.reasons:
                    console.show_note(f"report.html {reason}")
            else:
                from flexfmu.cosim.reports.plots import draw_plots
                from flexfmu.cosim.reports.report import report_page

                page = report_page(summary, draw_plots(found, rest))
            folder.write("report.html", page.html)
            files.append("report.html")
        else:
            folder.remove("report.html")
    # standard output
    if json:
        console.print_text(to_json(summary))
    else:
        from flexfmu.cosim.cli.run_summary import print_summary
        from flexfmu.model.choice_text import choice_sentence

        print_summary(summary, choice_sentence(robot), folder.path, files)
    if problem is not None:
        console.show_note(f"{problem}; what was recorded is in {folder.path}")
        return console.FAILURE
    return 0


def _run_ssp(
    source: Path,
    out: Path | None,
    told: tuple[float | None, float | None, str | None, int | None],
    isolate: bool | None,
    formats: Sequence[str],
    as_json: bool,
) -> int:
    """Simulate an SSP file, write results.csv and summary.json, and print how the run ended; the exit status.

    What was recorded before a failure is written too. ``told`` are stop time and step [s] in place of the file's own, one of several
    systems in it, and the highest output derivative of its FMUs that is read.
    """
    from flexfmu.cosim.exchange.ssp.archive import DESCRIPTION
    from flexfmu.cosim.exchange.ssp.loading import load_ssp
    from flexfmu.cosim.experiment.recording import slave_facts

    console.end_loading()
    stop, step, ssd, output_order = told
    loaded = load_ssp(source, stop=stop, step=step, ssd=ssd or DESCRIPTION, output_order=output_order)
    folder = console.prepared_folder(out or RESULTS / source.stem)
    # simulate, and write what was recorded even if it failed
    with console.progress() as show:
        simulation = loaded.simulate(progress=lambda fraction: show("simulating", fraction), isolate=isolate)
        show("writing the results", None)
        recording, title = simulation.recording, loaded.structure.name
        files = console.write_results(folder, recording, formats, {"system": title, "outcome": simulation.message})
        summary: dict[str, Any] = {
            "system": title,
            "outcome": simulation.outcome.name.lower(),
            "message": simulation.message,
            "start_time": loaded.start,
            "stop_time": loaded.stop,
            "end_time": float(recording.time[-1]) if recording.time.size else None,
            "communication_step": loaded.step,
            "steps": simulation.steps,
            "slaves": [
                {"name": each.name, "sample_time": each.sample_time, "offset": each.offset}
                for each in slave_facts(loaded.system.slaves)
            ],
            "connections": [loaded.system.describe(each) for each in loaded.system.connections],
            "ignored_parameters": list(loaded.ignored),
            "remarks": list(loaded.remarks),
            "units": recording.units,
            "results": {name: file_digest(folder.path / name) for name in files},
        }
        folder.write("summary.json", to_json(summary))
    # standard output
    if as_json:
        console.print_text(to_json(summary))
    else:
        from flexfmu.cosim.cli.run_summary import print_ssp_summary

        print_ssp_summary(summary, recording, folder.path, [*files, "summary.json"])
    if simulation.outcome.is_failure:
        console.show_note(f"{simulation.message}; what was recorded is in {folder.path}")
        return console.FAILURE
    return 0
