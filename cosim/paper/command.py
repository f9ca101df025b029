"""`flexfmu paper`: compute every table and figure, and write them as they become ready."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

from flexfmu.cosim.paper import frequencies, motions
from flexfmu.cosim.paper.cases import Case, simulated_cases
from flexfmu.cosim.paper.comparison import Evaluate, compare
from flexfmu.cosim.paper.output import write_report, write_simulations
from flexfmu.cosim.paper.reference import printed_table, printed_tables, source
from flexfmu.cosim.paper.report import PaperReport
from flexfmu.cosim.paper.simulations import Simulation, evaluators, simulate
from flexfmu.cosim.reports.output import RESULTS, OutputFolder
from flexfmu.cosim.reports.versions import versions

DEFAULT_FOLDER = RESULTS / "paper"
"""Where the results go unless the user says otherwise."""

TRAJECTORY_TABLES = ("table-02", "table-05", "table-06")

Progress = Callable[[str, float], None]
"""Called with what is being done and the finished fraction, 0..1."""


def run_paper(out: Path = DEFAULT_FOLDER, *, progress: Progress | None = None) -> PaperReport:
    """Run the paper's experiment and write tables and figures.

    Everything is written as soon as it is known: a run that is interrupted leaves what it has computed so far.
    ``out`` gets ``report.html``, ``paper.md``, ``paper.json``, ``tables/*.csv``, ``simulations.csv`` (every metric of
    every simulation), ``figures/*.png|svg`` and ``overview.png|svg``.

    Args:
        out: folder of the results, made if it isn't there.
        progress: told what is being done.

    Returns:
        The report: `to_markdown()`, `to_json()`, and `flexfmu.cosim.paper.terminal.print_report` for a terminal.

    Raises:
        PaperError: a simulation failed.
        ResultsError: ``out`` can't be written.
        BuildError: the FMU can't be built (no compiler, for example).
    """
    OutputFolder(out).prepare()
    report = PaperReport(source(), versions=versions())
    for name, stage in STAGES.items():
        started = perf_counter()
        report = stage(report, out, progress or _silent)
        report = replace(report, timing={**report.timing, name: perf_counter() - started})
        write_report(report, out)
    return report


def _trajectory_tables(report: PaperReport, out: Path, progress: Progress) -> PaperReport:
    progress("tables of the trajectories", 0.0)
    evaluate = motions.evaluators()
    return replace(report, tables=tuple(compare(printed_table(key), evaluate) for key in TRAJECTORY_TABLES))


def _trajectory_figures(report: PaperReport, out: Path, progress: Progress) -> PaperReport:
    from flexfmu.cosim.paper.figures import TRAJECTORY_FIGURES, draw_figure

    for index, (figure, draw) in enumerate(TRAJECTORY_FIGURES):
        progress(figure.label, 0.10 + 0.02 * index)
        draw_figure(figure, draw, out)
        report = replace(report, figures=(*report.figures, figure))
    return report


def _frequencies(report: PaperReport, out: Path, progress: Progress) -> PaperReport:
    progress("natural frequencies along the path", 0.25)
    table = compare(printed_table("frequencies"), frequencies.evaluators())
    return replace(report, tables=(*report.tables, table))


def _simulations(report: PaperReport, out: Path, progress: Progress) -> PaperReport:
    tables = [table for table in printed_tables() if table.scene]
    simulations = run_cases(simulated_cases(tables), out, progress)
    compared = (compare(table, _evaluators(table.scene, simulations)) for table in tables)
    report = replace(report, tables=(*report.tables, *compared), versions=versions(_fmu(simulations)))
    return _simulation_figures(report, simulations, out, progress)


def run_cases(cases: Sequence[Case], out: Path, progress: Progress) -> Mapping[Case, Simulation]:
    """Simulate the cases, and write ``simulations.csv`` after each of them.

    Raises:
        PaperError, ResultsError, BuildError: as `run_paper`.
    """
    done: dict[Case, Simulation] = {}
    progress("building the FMU", 0.30)
    for simulation in simulate(cases):
        done[simulation.case] = simulation
        write_simulations(done.values(), out)
        progress(f"simulated {', '.join(simulation.case)}", 0.30 + 0.65 * len(done) / len(cases))
    return done


def _fmu(simulations: Mapping[Case, Simulation]) -> Path:
    """The FMU that served all simulations."""
    return next(iter(simulations.values())).fmu_path


def _evaluators(scene: str, simulations: Mapping[Case, Simulation]) -> Mapping[str, Evaluate]:
    return {**motions.evaluators(), **evaluators(simulations, scene)}


def _simulation_figures(
    report: PaperReport, simulations: Mapping[Case, Simulation], out: Path, progress: Progress
) -> PaperReport:
    from flexfmu.cosim.paper.error_figures import path_errors
    from flexfmu.cosim.paper.figures import OVERVIEW, PATH_ERRORS, draw_figure
    from flexfmu.cosim.paper.overview import overview

    progress(PATH_ERRORS.label, 0.95)
    draw_figure(PATH_ERRORS, lambda: path_errors(simulations), out)
    progress(OVERVIEW.label, 0.97)
    draw_figure(OVERVIEW, lambda: overview(simulations, report.tables), out)
    progress("done", 1.0)
    return replace(report, figures=(*report.figures, PATH_ERRORS), overview=OVERVIEW)


def _silent(what: str, fraction: float) -> None:
    """Progress that nobody wants to see."""


STAGES: Mapping[str, Callable[[PaperReport, Path, Progress], PaperReport]] = {
    "trajectory tables": _trajectory_tables,
    "trajectory figures": _trajectory_figures,
    "frequencies": _frequencies,
    "simulations": _simulations,
}
"""The parts of the experiment in their order; each adds to the report."""
