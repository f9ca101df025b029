"""`flexfmu paper`: compute every table and figure, and write each as soon as it is computed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

from matplotlib.figure import Figure

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.files import RESULTS, OutputFolder
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.reports.figure_style import save, style
from flexfmu.cosim.reports.summary import versions
from flexfmu.cosim.studies.paper import computed, figures, spectra
from flexfmu.cosim.studies.paper.comparison import compare, printed_table, printed_tables
from flexfmu.cosim.studies.paper.computed import PaperCase, SimulatedCase, simulate, write_simulations
from flexfmu.cosim.studies.paper.report import PaperFigure, PaperReport, source, write_report

DrawFigure = Callable[[], Figure]

TRAJECTORY_FIGURES: tuple[tuple[PaperFigure, DrawFigure], ...] = (
    (
        PaperFigure("figure-06", "Figure 6", "The three blends overlaid, d = e = 25 mm."),
        figures.blends,
    ),
    (
        PaperFigure("figure-07", "Figure 7", "The motion profiles for a cycle time of 1 s."),
        figures.motion_profiles,
    ),
    (
        PaperFigure(
            "figure-08",
            "Figure 8",
            "Joint motion on the Lamé path with the seventh-degree polynomial in 1 s, and the power spectral density "
            "of the joint accelerations for all motion profiles (4 s window: motion, then standstill; bold: mean over 5 Hz).",
        ),
        spectra.joint_motion,
    ),
    (
        PaperFigure(
            "figure-09", "Figure 9", "The path, the mechanism at its start, middle and end, and the workspace."
        ),
        figures.placement,
    ),
    (
        PaperFigure(
            "figure-10", "Figure 10", "Spectral content of the polynomial on the Lamé path for three cycle times."
        ),
        spectra.cycle_times,
    ),
    (
        PaperFigure(
            "figure-11", "Figure 11", "Spectral content of the same motion in 1 s for three lengths of the blends."
        ),
        spectra.blend_lengths,
    ),
)
"""Figures that need no simulation."""

PATH_ERRORS = PaperFigure(
    "figure-12",
    "Figure 12",
    "Path-tracking error of the end effector with the payload of 6 kg, over the motion of 0.43 s and the dwell.",
)

OVERVIEW = PaperFigure(
    "overview",
    "Overview",
    "The flexible five-bar robot on its pick-and-place path, the error that its elasticity leaves, "
    "and the 72 figures of Tables 7 and 9 beside those computed through the FMU.",
    folder="",
)


def draw_figure(figure: PaperFigure, draw: DrawFigure, folder: Path) -> None:
    """Draw a figure and write it as PNG and SVG to the report's folder.

    Raises:
        ResultsError: the folder can't be written.
    """
    stem = folder / figure.file("")
    try:
        with style():
            save(draw(), stem)
    except OSError as error:
        raise ResultsError(
            f"can't write {stem}: {error.strerror or error}; choose another folder or free some space"
        ) from error


DEFAULT_FOLDER = RESULTS / "paper"
"""Default folder of the results."""

TRAJECTORY_TABLES = ("table-02", "table-05", "table-06")


def run_paper(out: Path = DEFAULT_FOLDER, *, progress: ShowProgress = quiet) -> PaperReport:
    """Run the paper's experiment and write tables and figures.

    Results are written as soon as they are computed, so that an interrupted run keeps those it has.
    ``out`` gets ``report.html``, ``paper.md``, ``paper.json``, ``tables/*.csv``, ``simulations.csv`` (every metric of
    every simulation), ``figures/*.png|svg`` and ``overview.png|svg``.

    Args:
        out: folder of the results, created if missing.
        progress: called with the current activity and the finished fraction.

    Returns:
        The report: `to_markdown()`, `to_json()`, and `flexfmu.cosim.studies.paper.report.print_report` for a terminal.

    Raises:
        PaperError: a simulation failed.
        ResultsError: ``out`` can't be written.
        BuildError: the FMU can't be built (no compiler, for example).
    """
    OutputFolder(out).prepare()
    report = PaperReport(source(), versions=versions())
    for name, stage in STAGES.items():
        started = perf_counter()
        report = stage(report, out, progress)
        report = replace(report, timing={**report.timing, name: perf_counter() - started})
        write_report(report, out)
    return report


def _trajectory_tables(report: PaperReport, out: Path, progress: ShowProgress) -> PaperReport:
    progress("tables of the trajectories", 0.0)
    evaluate = computed.motion_evaluators()
    return replace(report, tables=tuple(compare(printed_table(key), evaluate) for key in TRAJECTORY_TABLES))


def _trajectory_figures(report: PaperReport, out: Path, progress: ShowProgress) -> PaperReport:
    for index, (figure, draw) in enumerate(TRAJECTORY_FIGURES):
        progress(figure.label, 0.10 + 0.02 * index)
        draw_figure(figure, draw, out)
        report = replace(report, figures=(*report.figures, figure))
    return report


def _frequencies(report: PaperReport, out: Path, progress: ShowProgress) -> PaperReport:
    progress("natural frequencies along the path", 0.25)
    table = compare(printed_table("frequencies"), computed.frequency_evaluators())
    return replace(report, tables=(*report.tables, table))


def _simulations(report: PaperReport, out: Path, progress: ShowProgress) -> PaperReport:
    # tables about simulations, each with the evaluators of its own scene
    tables = [table for table in printed_tables() if table.scene]
    simulations = simulate_cases(computed.simulated_cases(tables), out, progress)
    motions = computed.motion_evaluators()
    compared = tuple(
        compare(table, {**motions, **computed.simulation_evaluators(simulations, table.scene)}) for table in tables
    )
    # one FMU serves all simulations, so its versions are those of every table
    fmu = next(iter(simulations.values())).fmu_path
    report = replace(report, tables=(*report.tables, *compared), versions=versions(fmu))
    # figures of the results
    progress(PATH_ERRORS.label, 0.95)
    draw_figure(PATH_ERRORS, lambda: figures.path_errors(simulations), out)
    progress(OVERVIEW.label, 0.97)
    draw_figure(OVERVIEW, lambda: figures.overview(simulations, report.tables), out)
    progress("done", 1.0)
    return replace(report, figures=(*report.figures, PATH_ERRORS), overview=OVERVIEW)


def simulate_cases(cases: Sequence[PaperCase], out: Path, progress: ShowProgress) -> Mapping[PaperCase, SimulatedCase]:
    """Simulate the cases, and write ``simulations.csv`` after each of them.

    Raises:
        PaperError, ResultsError, BuildError: as `run_paper`.
    """
    done: dict[PaperCase, SimulatedCase] = {}
    progress("building the FMU", 0.30)
    for simulation in simulate(cases):
        done[simulation.case] = simulation
        write_simulations(done.values(), out)
        progress(f"simulated {', '.join(simulation.case)}", 0.30 + 0.65 * len(done) / len(cases))
    return done


STAGES: Mapping[str, Callable[[PaperReport, Path, ShowProgress], PaperReport]] = {
    "trajectory tables": _trajectory_tables,
    "trajectory figures": _trajectory_figures,
    "frequencies": _frequencies,
    "simulations": _simulations,
}
"""Name → stage of the experiment, in order; each stage returns the report with its results added."""
