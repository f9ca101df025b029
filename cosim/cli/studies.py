"""`flexfmu compare`, `paper` and `workprec`: runs, scenes and a measurement side by side; the paper's tables beside the computed ones; what
accuracy costs, and with `--hard` whether hard cases stay right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.cosim.cli.console import (
    FAILURE,
    load_resolved,
    prepared_folder,
    print_result,
    print_text,
    progress,
    rich_output,
    show_note,
    usual_folder,
)
from flexfmu.cosim.cli.options import OptionalScene
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import RESULTS, to_json

if TYPE_CHECKING:
    from rich.console import RenderableType

    from flexfmu.cosim.studies.compare.comparison import Comparison


def compare(
    runs: list[str],
    measured: Path | None = None,
    mapping: list[str] | None = None,
    delay: float | None = None,
    variant: list[str] | None = None,
    payload_band: str | None = None,
    settings: list[str] | None = None,
    out: Path | None = None,
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
        payload_band (BAND): Also run scenes with other payloads, unknown to the controllers: 0.2 for 20 % to both sides, or
            4,8 for 4 and 8 kg. Default: skip.
        out (DIR): Write comparison.html and comparison.json there. Default: nowhere.
    """
    from flexfmu.cosim.design.gains.robustness import parse_band
    from flexfmu.cosim.studies.compare.comparison import compare_runs
    from flexfmu.cosim.studies.compare.measured import parse_mapping
    from flexfmu.cosim.studies.compare.sources import compared_runs, given_sources

    # what can be wrong is checked before anything is simulated
    meaning = dict(map(parse_mapping, mapping or ()))
    if measured is not None and not measured.is_file():
        raise InputError(f"there is no file {measured}")
    if out is not None:
        prepared_folder(out)
    band = None if payload_band is None else parse_band(payload_band)
    sources = given_sources(runs, variant or (), settings or ())
    with progress() as show:
        found = compare_runs(compared_runs(sources, show, band), measured, meaning, delay)
    if out is not None:
        found.write(out)
    print_result(json, found.as_data(), *_shown(found, out))
    failed = [run for run in found.runs if run.failure]
    for run in failed:
        show_note(f"{run.name}{'' if run.metrics else ' failed'}: {run.failure}")
    return FAILURE if failed else 0


def _shown(found: Comparison, out: Path | None) -> Iterator[RenderableType]:
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


def paper(
    out: Path | None = None,
    json: bool = False,
) -> int:
    """Repeat the paper's experiment: compare every table with the printed one, and draw the figures.

    Barnard, Briot and Caro, "Trajectory Generation for High Speed Pick-and-Place Robots", ESDA 2012.

    Args:
        out (DIR): Folder of the results. Default: results/paper.
    """
    from flexfmu.cosim.studies.paper.report import DEFAULT_FOLDER, print_report, run_paper

    folder = prepared_folder(out or DEFAULT_FOLDER).path
    with progress() as show:
        report = run_paper(folder, progress=show)
    # standard output
    if json:
        print_text(report.to_json())
        return 0
    with rich_output() as console:
        print_report(report, console)
    print_text(f"Report, tables and figures are in {folder}\n")
    return 0


HARD_CASES = "hard-cases"
"""Name of the suite's folder and files."""


def workprec(
    scene: OptionalScene = None,
    out: Path | None = None,
    only: list[str] | None = None,
    hard: bool = False,
    restart: bool = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Measure what accuracy costs in time: by integrator, communication step, coupling, effects, formulation and tool.

    Writes workprec.json, workprec.md, workprec.html and pictures. Takes some minutes; every trial is kept at once, and
    whatever ends the command, the same command continues.

    With --hard, run cases that simulations of this robot are most likely to get wrong; exit status 1 if one fails. Writes
    hard-cases.json and hard-cases.md.

    Args:
        out (DIR): Folder of the results. Default: results/<name of the scene>/workprec or results/hard-cases.
        only (FAMILY): integrators, communication, algorithms, effects, formulations or tools; with --hard a part of a case's
            name; may be repeated. Default: all.
        hard: Run the hard cases instead, without SCENE: what makes each hard, and what happened. Default: measure SCENE.
        restart: Discard what an interrupted study of another scene has left in the folder. Default: refuse.
    """
    if hard:
        return _hard_cases(scene, out, only or [], settings or [], json)
    return _study(scene, out, only or [], settings or [], json, restart)


def _study(
    source: str | None, out: Path | None, families: Sequence[str], settings: Sequence[str], as_json: bool, restart: bool
) -> int:
    """Measure, write the results, and print them; the exit status."""
    from flexfmu.benchmarks.peers.exudyn_trials import exudyn_trials
    from flexfmu.cosim.many.journal import WorkJournal, about_scene
    from flexfmu.cosim.studies.workprec.figures import html, save_figures
    from flexfmu.cosim.studies.workprec.study import FAMILIES, data, markdown, notes, run_study, terminal_table

    # usage
    if source is None:
        raise InputError("workprec needs a SCENE, or --hard for the hard cases, which have robots of their own")
    unknown = [each for each in families if each not in FAMILIES]
    if unknown:
        raise InputError(f"--only takes {', '.join(FAMILIES)}, got {unknown[0]}")
    # measure, and write each file as soon as it is known
    scene = load_resolved(source, settings)
    folder = prepared_folder(out or usual_folder(scene.name, settings) / "workprec")
    journal = WorkJournal(folder.path, "study", about_scene(scene), restart=restart, note=show_note)
    with progress() as show:
        study = run_study(
            scene, families or FAMILIES, lambda text: show(text, None), peers=(exudyn_trials,), journal=journal
        )
        folder.write("workprec.json", to_json(data(study)))
        folder.write("workprec.md", markdown(study))
        show("pictures", None)
        save_figures(study, folder.path)
        folder.write("workprec.html", html(study))
        journal.remove()
    where = f"workprec.json, workprec.md, workprec.html and pictures are in {folder.path}"
    print_result(as_json, data(study), terminal_table(study), *notes(study), where)
    return 0


def _hard_cases(
    source: str | None, out: Path | None, names: Sequence[str], settings: Sequence[str], as_json: bool
) -> int:
    """Run the hard cases, write what happened, and print it; the exit status."""
    from flexfmu.benchmarks.hard_cases.suite import conclusion, data, hard_cases, markdown, run_cases, terminal_table

    if source is not None:
        raise InputError(f"the hard cases have robots of their own: leave out {source}")
    if settings:
        raise InputError(f"the hard cases have robots of their own: leave out --set {settings[0]}")
    # run them all, and write what happened
    cases = hard_cases(names)
    folder = prepared_folder(out or RESULTS / HARD_CASES)
    with progress() as show:
        results = run_cases(cases, lambda text: show(text, None))
    folder.write(f"{HARD_CASES}.json", to_json(data(results)))
    folder.write(f"{HARD_CASES}.md", markdown(results))
    where = f"{HARD_CASES}.json and {HARD_CASES}.md are in {folder.path}"
    print_result(as_json, data(results), terminal_table(results), conclusion(results), where)
    return 0 if all(result.report.passed for result in results) else FAILURE
