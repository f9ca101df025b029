"""The figures of the report: what each of them is, and how it gets into its files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure as Drawing

from flexfmu.cosim.errors import ResultsError
from flexfmu.cosim.paper import path_figures, spectrum_figures
from flexfmu.cosim.paper.report import Figure
from flexfmu.cosim.reports.figure_style import save, style

Draw = Callable[[], Drawing]

TRAJECTORY_FIGURES: tuple[tuple[Figure, Draw], ...] = (
    (
        Figure("figure-06", "Figure 6", "The three blends overlaid, d = e = 25 mm."),
        path_figures.blends,
    ),
    (
        Figure("figure-07", "Figure 7", "The motion profiles for a cycle time of 1 s."),
        path_figures.motion_profiles,
    ),
    (
        Figure(
            "figure-08",
            "Figure 8",
            "Joint motion on the Lamé path with the seventh-degree polynomial in 1 s, and the power spectral density "
            "of the joint accelerations for all motion profiles (4 s window: motion, then standstill; bold: mean over 5 Hz).",
        ),
        spectrum_figures.joint_motion,
    ),
    (
        Figure("figure-09", "Figure 9", "The path, the mechanism at its start, middle and end, and the workspace."),
        path_figures.placement,
    ),
    (
        Figure("figure-10", "Figure 10", "Spectral content of the polynomial on the Lamé path for three cycle times."),
        spectrum_figures.cycle_times,
    ),
    (
        Figure("figure-11", "Figure 11", "Spectral content of the same motion in 1 s for three lengths of the blends."),
        spectrum_figures.blend_lengths,
    ),
)
"""Figures that need no simulation."""

PATH_ERRORS = Figure(
    "figure-12",
    "Figure 12",
    "Path-tracking error of the end effector with the payload of 6 kg, over the motion of 0.43 s and the dwell.",
)

OVERVIEW = Figure(
    "overview",
    "Overview",
    "The flexible five-bar robot on its pick-and-place path, the error that its elasticity leaves, "
    "and the 72 figures of Tables 7 and 9 beside those computed through the FMU.",
    folder="",
)


def draw_figure(figure: Figure, draw: Draw, folder: Path) -> None:
    """Draw a figure and write it as PNG and SVG into the report's folder.

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
