"""`flexfmu paper` and `workprec`: the paper's tables beside the computed ones; what accuracy costs, and with `--hard` whether hard cases
stay right."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flexfmu.cosim.cli.console import FAILURE, load_resolved, print_rich, print_text, progress, rich_output
from flexfmu.cosim.cli.options import OptionalScene
from flexfmu.cosim.cli.result_files import usual_folder
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import RESULTS, OutputFolder
from flexfmu.cosim.reports.text import to_json


def paper(
    out: Path | None = None,
    json: bool = False,
) -> int:
    """Repeat the paper's experiment: every table beside the printed one, and the figures.

    Barnard, Briot and Caro, "Trajectory Generation for High Speed Pick-and-Place Robots", ESDA 2012.

    Args:
        out (DIR): Folder of the results. Default: results/paper.
    """
    from flexfmu.cosim.studies.paper.command import DEFAULT_FOLDER, run_paper
    from flexfmu.cosim.studies.paper.report import print_report

    folder = out or DEFAULT_FOLDER
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
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Measure what accuracy costs in time: by integrator, communication step, coupling, effects, formulation and tool.

    Writes workprec.json, workprec.md, workprec.html and pictures. Takes some minutes.

    With --hard, run cases that simulations of this robot are most likely to get wrong; exit status 1 if one fails. Writes
    hard-cases.json and hard-cases.md.

    Args:
        out (DIR): Folder of the results. Default: results/<name of the scene>/workprec or results/hard-cases.
        only (FAMILY): integrators, communication, algorithms, effects, formulations or tools; with --hard a part of a case's
            name; may be repeated. Default: all.
        hard: Run the hard cases instead, without SCENE: what makes each hard, and what happened. Default: measure SCENE.
    """
    return (_hard_cases if hard else _study)(scene, out, only or [], settings or [], json)


def _study(
    source: str | None, out: Path | None, families: Sequence[str], settings: Sequence[str], as_json: bool
) -> int:
    """Measure, write the results, and print them; the exit status."""
    from rich.text import Text

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
    folder = OutputFolder(out or usual_folder(scene.name, settings) / "workprec")
    folder.prepare()
    with progress() as show:
        study = run_study(scene, families or FAMILIES, lambda text: show(text, None))
        folder.write("workprec.json", to_json(data(study)))
        folder.write("workprec.md", markdown(study))
        show("pictures", None)
        save_figures(study, folder.path)
        folder.write("workprec.html", html(study))
    # standard output
    if as_json:
        print_text(to_json(data(study)))
    else:
        print_rich(terminal_table(study), *(Text(note) for note in notes(study)))
        print_text(f"workprec.json, workprec.md, workprec.html and pictures are in {folder.path}\n")
    return 0


def _hard_cases(
    source: str | None, out: Path | None, names: Sequence[str], settings: Sequence[str], as_json: bool
) -> int:
    """Run the hard cases, write what happened, and print it; the exit status."""
    from rich.text import Text

    from flexfmu.benchmarks.hard_cases.suite import conclusion, data, hard_cases, markdown, run_cases, terminal_table

    if source is not None:
        raise InputError(f"the hard cases have robots of their own: leave out {source}")
    if settings:
        raise InputError(f"the hard cases have robots of their own: leave out --set {settings[0]}")
    # run them all, and write what happened
    cases = hard_cases(names)
    folder = OutputFolder(out or RESULTS / HARD_CASES)
    folder.prepare()
    with progress() as show:
        results = run_cases(cases, lambda text: show(text, None))
    text = to_json(data(results))
    folder.write(f"{HARD_CASES}.json", text)
    folder.write(f"{HARD_CASES}.md", markdown(results))
    # standard output
    if as_json:
        print_text(text)
    else:
        print_rich(terminal_table(results), Text(conclusion(results)))
        print_text(f"{HARD_CASES}.json and {HARD_CASES}.md are in {folder.path}\n")
    return 0 if all(result.report.passed for result in results) else FAILURE
