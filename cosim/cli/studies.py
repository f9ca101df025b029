"""`flexfmu compare`, `sweep`, `paper` and `workprec`: runs, scenes and a measurement side by side; many variants of a scene, resumable, as one
table and picture; the tables of the paper beside the computed ones; what accuracy costs, and with `--hard` whether hard cases stay right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flexfmu.cosim.cli import console
from flexfmu.cosim.cli.options import OptionalScene, ProcessesOption
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import RESULTS, to_json

if TYPE_CHECKING:
    from rich.console import RenderableType

    from flexfmu.cosim.studies.compare.comparison import Comparison
    from flexfmu.cosim.studies.sweep.cases import Cases
    from flexfmu.cosim.studies.sweep.result import SweepResult
    from flexfmu.model.scene.schema import Scene


def compare(
    runs: list[str],
    measured: Path | None = None,
    mapping: list[str] | None = None,
    delay: float | None = None,
    variant: list[str] | None = None,
    payload_band: str | None = None,
    strict: bool = False,
    live: bool = False,
    settings: list[str] | None = None,
    out: Path | None = None,
    sandbox: bool = False,
    json: bool = False,
) -> int:
    """Compare runs with each other and with a measurement: metrics side by side, signals over each other, spectra.

    Differences are relative to the first run. For scenes margins, processor times and the worst values over a band of
    payloads are compared too. A measurement is aligned in time with the first run; RMS, mean and largest difference of each
    signal are those over their common time.

    Args:
        runs (RUN): A folder of results, a results file (.csv, .parquet, .mat), or a scene, which is run now; NAME=SCENE gives it
            another name.
        measured (LOG.csv): A measurement: a CSV file with a header and a column `time`. Columns named like signals are
            compared. Default: none.
        mapping (--map COLUMN=SIGNAL): What a measured column is, with a factor or a unit and an offset if needed:
            tau1=joint1.torque*1e-3, phi=joint1.position*deg+0.5, t=time*ms. May be repeated. Default: by the names.
        delay (SECONDS): Time of an event in the measurement minus that in the simulation. Default: estimated by correlation.
        variant (NAME:KEY=VALUE): The first scene with other values, as one more run; several with commas:
            stiff:pd.kp=2e4,pd.kd=200. May be repeated. Default: none.
        payload_band (BAND): Also run scenes with other payloads, unknown to the controllers: 0.2 for 20 % to both sides,
            4,8 for 4 and 8 kg, or an identified.json for its interval. Default: skip.
        strict: Refuse files with values that are no finite numbers (nan, inf). Default: leave them out and tell the line.
        live: Let comparison.html simulate all scenes side by side, with common sliders. It needs ziglang, and --out. Default: the page
            shows the runs alone.
        out (DIR): Write comparison.html and comparison.json there. Default: nowhere.
    """
    from flexfmu.cosim.design.gains.robustness import parse_band
    from flexfmu.cosim.engine.measured import parse_mapping
    from flexfmu.cosim.studies.compare.comparison import compare_runs
    from flexfmu.cosim.studies.compare.sources import compared_runs, given_sources

    if sandbox:
        from flexfmu.cosim.cli.sandbox import run_in_sandbox

        run_in_sandbox(out)
    # what can be wrong is checked before anything is simulated
    if live and out is None:
        raise InputError("--live is about comparison.html: add --out DIR")
    if live:
        console.check_page_compiler()
    meaning = dict(map(parse_mapping, mapping or ()))
    if measured is not None and (measured.is_dir() or not measured.exists()):
        raise InputError(f"there is no file {measured}")
    if out is not None:
        console.prepared_folder(out)
    band = None if payload_band is None else parse_band(payload_band)
    sources = given_sources(runs, variant or (), settings or (), console.load_named)
    with console.progress() as show:
        found = compare_runs(compared_runs(sources, show, band, strict=strict), measured, meaning, delay, strict=strict)
    if not found.tables():
        names = " and ".join(run.name for run in found.runs)
        raise InputError(
            f"there is nothing to compare: {names} have no metrics, which summary.json beside results has, and no common "
            "signals; give a second run, a scene, or a measurement with --measured"
        )
    if out is not None:
        found.write(out, live=live)
    console.print_result(json, found.as_data(), *_shown_comparison(found, out))
    failed = [run for run in found.runs if run.failure]
    for run in failed:
        console.show_note(f"{run.name}{'' if run.metrics else ' failed'}: {run.failure}")
    return console.FAILURE if failed else 0


def _shown_comparison(found: Comparison, out: Path | None) -> Iterator[RenderableType]:
    """The tables of the page, and where it is."""
    from rich.text import Text

    from flexfmu.cosim.reports.terminal import as_terminal_table
    from flexfmu.cosim.studies.compare.comparison import POORLY, delay_text

    yield from map(as_terminal_table, found.tables())
    measured = found.measured
    if measured is not None:
        yield f"{measured.name} is {delay_text(measured.delay)}"
        if measured.delay.correlation < POORLY:
            warning = "warning: measurement and simulation hardly look alike; check --map, signs and --delay"
            yield Text(warning, style="yellow")
    if out is not None:
        yield f"comparison.html and comparison.json are in {out}"


def paper(out: Path | None = None, json: bool = False) -> int:
    """Repeat the paper's experiment: compare every table with the printed one, and draw the figures.

    Barnard, Briot and Caro, "Trajectory Generation for High Speed Pick-and-Place Robots", ESDA 2012.

    Args:
        out (DIR): Folder of the results. Default: results/paper.
    """
    from flexfmu.cosim.studies.paper.report import DEFAULT_FOLDER, print_report, run_paper

    folder = console.prepared_folder(out or DEFAULT_FOLDER).path
    with console.progress() as show:
        report = run_paper(folder, progress=show)
    # standard output
    if json:
        console.print_text(report.to_json())
        return 0
    with console.rich_output() as terminal:
        print_report(report, terminal)
    console.print_text(f"Report, tables and figures are in {folder}\n")
    return 0


HARD_CASES = "hard-cases"
"""Name of the suite's folder and files."""


def workprec(
    scene: OptionalScene = None,
    out: Path | None = None,
    only: list[str] | None = None,
    of: list[str] | None = None,
    hard: bool = False,
    restart: bool = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Measure what accuracy costs in time: by integrator, communication step, coupling, effects, formulation and tool.

    Writes workprec.json, workprec.md, workprec.html and pictures. Takes some minutes; every trial is kept at once, and
    whatever ends the command, the same command continues.

    With --of, the accuracy of metrics of the scene as it is, loop included: time over error for sets of effects from rigid links to the
    richest, and the cheapest setting for errors of 1e-2 to 1e-10.

    With --hard, run cases that simulations of this robot are most likely to get wrong; exit status 1 if one fails. Writes
    hard-cases.json, hard-cases.md and hard-cases.html.

    Args:
        out (DIR): Folder of the results. Default: results/<name of the scene>/workprec or results/hard-cases.
        only (FAMILY): integrators, communication, algorithms, effects, formulations or tools; with --hard a part of a case's
            name; may be repeated. Default: all.
        of (METRICS): Metrics and margins, separated by commas; may be repeated. Default: the families of --only, of the path alone.
        hard: Run the hard cases instead, without SCENE: what makes each hard, and what happened. Default: measure SCENE.
        restart: Discard what an interrupted study of another scene has left in the folder. Default: refuse.
    """
    metrics = list(dict.fromkeys(each.strip() for text in of or () for each in text.split(",") if each.strip()))
    if metrics and (hard or only):
        raise InputError("--of goes without --only and --hard")
    if hard:
        return _hard_cases(scene, out, only or (), settings or (), json)
    from flexfmu.benchmarks.peers.compiled_peer import compiled_trials
    from flexfmu.benchmarks.peers.exudyn_trials import exudyn_trials
    from flexfmu.cosim.design.effects.accuracy import check_figures
    from flexfmu.cosim.many.journal import WorkJournal, about_scene
    from flexfmu.cosim.studies.workprec.figures import html, save_figures
    from flexfmu.cosim.studies.workprec.study import (
        FAMILIES,
        data,
        markdown,
        notes,
        run_metric_study,
        run_study,
        terminal_table,
    )

    # usage
    if scene is None:
        raise InputError("workprec needs a SCENE, or --hard for the hard cases, which have robots of their own")
    unknown = [each for each in only or () if each not in FAMILIES]
    if unknown:
        raise InputError(f"--only takes {', '.join(FAMILIES)}, got {unknown[0]}")
    # measure, and write each file as soon as it is known
    robot = console.load_resolved(scene, settings)
    check_figures(robot, dict.fromkeys(metrics, 1.0), "--of")
    folder = console.prepared_folder(out or console.usual_folder(robot.name, settings) / "workprec")
    about = about_scene(robot) | ({"of": metrics} if metrics else {})
    journal = WorkJournal(folder.path, "study", about, restart=restart, note=console.show_note)
    with console.progress() as show:
        try:
            if metrics:
                study = run_metric_study(robot, metrics, show, journal)
            else:
                peers = (compiled_trials, exudyn_trials)
                study = run_study(robot, only or FAMILIES, lambda text: show(text, None), peers=peers, journal=journal)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"{journal.done} runs are kept in {folder.path}; the same command continues"
            ) from None
        folder.write("workprec.json", to_json(data(study)))
        folder.write("workprec.md", markdown(study))
        show("pictures", None)
        save_figures(study, folder.path)
        folder.write("workprec.html", html(study))
        journal.remove()
    where = f"workprec.json, workprec.md, workprec.html and pictures are in {folder.path}"
    console.print_result(json, data(study), terminal_table(study), *notes(study), where)
    return 0


def _hard_cases(
    source: str | None, out: Path | None, names: Sequence[str], settings: Sequence[str], as_json: bool
) -> int:
    """Run the hard cases, write what happened, and print it; the exit status."""
    from flexfmu.benchmarks.hard_cases import suite

    if source is not None:
        raise InputError(f"the hard cases have robots of their own: leave out {source}")
    if settings:
        raise InputError(f"the hard cases have robots of their own: leave out --set {settings[0]}")
    # run them all, and write what happened
    cases = suite.hard_cases(names)
    folder = console.prepared_folder(out or RESULTS / HARD_CASES)
    with console.progress() as show:
        results = suite.run_cases(cases, lambda text: show(text, None))
    data, files = suite.data(results), [f"{HARD_CASES}.{ending}" for ending in ("json", "md", "html")]
    for name, text in zip(files, (to_json(data), suite.markdown(results), suite.html(results)), strict=True):
        folder.write(name, text)
    where = console.files_sentence(files, folder.path)
    console.print_result(as_json, data, suite.terminal_table(results), suite.conclusion(results), where)
    return 0 if all(result.report.passed for result in results) else console.FAILURE


def sweep(
    scene: str,
    vary: list[str] | None = None,
    sample: str | None = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    cases: Path | None = None,
    metrics: list[str] | None = None,
    record: list[str] | None = None,
    record_step: float | None = None,
    processes: ProcessesOption = None,
    out: Path | None = None,
    restart: bool = False,
    dask: str | None = None,
    plot: bool | None = None,
    live: bool = False,
    stop_time: float | None = None,
    step: float | None = None,
    sandbox: bool = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Simulate many variants of a scene, or of a model from equations: writes sweep.csv (and sweep.parquet) with the metrics of each, and
    a picture.

    Every finished case is kept at once. After Ctrl-C or a crash the same command continues, and ends with the same
    table. A case that fails is a line with its message.

    Args:
        scene (SCENE): A scene, or MODEL.py:NAME, a Python file, which is run, and the name of its model; the keys are its parameters, the
            metrics smallest, largest and last values of its outputs, or of those to record.
        vary (KEY=VALUES): A key of the scene and its values: payload.mass=0:8:50 (from, to, number),
            trajectory.duration=0.3,0.4, controller.pd.derivative=50:200 (an interval for --sample). May be repeated: all
            combinations. Default: nothing.
        sample (METHOD:N): Instead of all combinations N cases of a Latin hypercube, lhs:1000, or of a Sobol sequence,
            sobol:1024. Default: all combinations.
        seed (N): Seed of the sample.
        cases (FILE.csv): Cases one by one: keys in the first line, a case in each other line; an empty cell leaves the scene's
            value. Or an identified.json, for draws from the joint distribution of its estimates. Default: those of --vary.
        metrics (NAMES): Metrics, separated by commas; may be repeated. Default: all.
        record (SIGNAL): Keep this signal of each case, in signals/; may be repeated. Default: none.
        record_step (SECONDS): Interval of the kept signals. Default: every instant.
        out (DIR): Folder of the results. Default: results/<name of the scene>-sweep.
        restart: Discard the results of another sweep in the folder. Default: refuse.
        dask (ADDRESS): Simulate on the workers of this Dask scheduler, tcp://host:8786. Default: this machine.
        plot: Draw sweep.png, sweep.svg and sweep.html. Default: draw them, but with --json don't.
        live: Let sweep.html simulate the scene: pick a point, or move the sliders of the swept keys. It needs ziglang. Default: the page
            shows the cases alone.
        stop_time (SECONDS): End of a model's runs. Default: a scene has its own.
        step (SECONDS): Communication step of a model's runs. Default: a scene has its own.
    """
    from flexfmu.cosim.engine.results import Selection
    from flexfmu.cosim.studies.sweep.model_sweep import sweep_model
    from flexfmu.cosim.studies.sweep.result import write_files
    from flexfmu.cosim.studies.sweep.sweep import ready_to_sweep, sweep_scene
    from flexfmu.model.symbolic import SymbolicBlock

    if sandbox:
        from flexfmu.cosim.cli.sandbox import run_in_sandbox

        name = scene.rpartition(":")[2] if ".py:" in scene else console.scene_name(scene, settings)
        folder = out or console.usual_folder(name, settings, "-sweep")
        run_in_sandbox(folder)
    model = console.own_model(scene, settings)
    if isinstance(model, SymbolicBlock):
        raise InputError(f"{scene} is a block without motion of its own; sweep a model that has it as a part")
    given = {"--metrics": metrics, "--record-step": record_step, "--processes": processes, "--dask": dask}
    alien = [name for name, value in given.items() if value is not None] if model else []
    if alien:
        raise InputError(f"{alien[0]} is for scenes; of a model all outputs are measured, or those of --record")
    if (stop_time is None or step is None) if model else (stop_time is not None or step is not None):
        raise InputError("--stop-time and --step in s are for models from equations, which need both")
    if live and model:
        raise InputError(
            "--live simulates a scene in the page; a model has its page by flexfmu build --platform wasm32"
        )
    if live:
        console.check_page_compiler()
    robot = None if model else console.load_resolved(scene, settings, keeps_accuracy=True)
    wanted = _swept_cases(robot, vary or [], sample, seed, cases)
    if record_step is not None and not record:
        raise InputError("--record-step goes with --record SIGNAL")
    selection = Selection(list(dict.fromkeys(record)), step=record_step) if record else None
    names = None if metrics is None else [each.strip() for text in metrics for each in text.split(",")]
    folder = out or console.usual_folder(scene.rpartition(":")[2] if robot is None else robot.name, settings, "-sweep")
    done = [0, 0]
    try:
        with console.progress() as show:

            def report(finished: int, total: int) -> None:
                if not any(done) and 0 < finished < total:
                    console.show_note(f"continuing: {finished} of {total} done")
                done[:] = finished, total
                show(f"{finished} of {total} cases", finished / total if total else 1.0)

            if model is not None:
                times = stop_time or 0.0, step or 0.0
                result = sweep_model(model, wanted, *times, record=record, folder=folder, restart=restart, show=report)
            elif robot is not None:
                result = sweep_scene(
                    ready_to_sweep(robot, wanted, show, console.show_note),
                    wanted,
                    metrics=names,
                    record=selection,
                    processes=processes,
                    folder=folder,
                    restart=restart,
                    dask=dask,
                    show=report,
                )
            show("writing the results", None)
            files = write_files(result, folder, plot=live or (not json if plot is None else plot), live=live)
    except KeyboardInterrupt:
        where = f"{done[0]} of {done[1]} cases are in {folder}" if any(done) else "before the first case"
        console.show_note(f"interrupted: {where}; the same command continues")
        return console.FAILURE
    data = {
        "scene": result.name,
        "cases": len(result),
        "failed": [{"case": row["case"], "message": row["message"]} for row in result.failed],
        "metrics": result.summary(),
        "files": [str(path) for path in files],
    }
    console.print_result(json, data, *_shown_sweep(result, files))
    return console.FAILURE if len(result.messages) == len(result) else 0


def _swept_cases(robot: Scene | None, vary: list[str], sample: str | None, seed: int, path: Path | None) -> Cases:
    """The cases by the options; notes on standard error tell what is left out.

    Raises:
        InputError: the options contradict each other, or one is of another form.
    """
    from flexfmu.cosim.studies.sweep.cases import make_cases, parse_vary, read_cases

    if path is not None:
        if vary or sample is not None:
            raise InputError("--cases has all cases: leave out --vary and --sample")
        found, notes = read_cases(path)
    else:
        varied = [parse_vary(option) for option in vary]
        twice = [key for i, (key, _) in enumerate(varied) if key in dict(varied[:i])]
        if twice:
            raise InputError(f"--vary {twice[0]} is there twice: give all of its values at once, {twice[0]}=1,2,3")
        found, notes = make_cases(dict(varied), sample, seed, robot)
    for note in notes:
        console.show_note(note)
    return found


def _shown_sweep(result: SweepResult, files: list[Path]) -> Iterator[RenderableType]:
    """The extremes of each metric, failed cases and files."""
    from flexfmu.cosim.reports.terminal import as_terminal_table

    yield as_terminal_table(result.table(), ("At", "at"))
    if failed := result.failed:
        yield f"{len(failed)} failed, the first with {result.case_text(failed[0]['case'])}: {failed[0]['message']}"
    yield f"results: {', '.join(map(str, files))}"
