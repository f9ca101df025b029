"""Figures of the simulations: path-tracking error in the task space (Fig. 12), and one picture that sums the experiment up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.reports.figure_style import GREY, INK, draw, mark_end
from flexfmu.cosim.studies.paper.comparison import ComparisonTable
from flexfmu.cosim.studies.paper.path_figures import (
    CURVE_COLOURS,
    PROFILE_COLOURS,
    draw_bases,
    draw_mechanism,
    draw_path,
)
from flexfmu.cosim.studies.paper.simulations import PaperCase, SimulatedCase, case_scene

HEAVY_SCENE = "barnard2012-6kg"


def path_errors(simulations: Mapping[PaperCase, SimulatedCase]) -> Figure:
    """Fig. 12: norm of the position error for the payload of 6 kg, one panel for each curve."""
    drawing = draw(7.6, 8.2)
    panels = drawing.subplots(3, 1, sharex=True, sharey=True)
    for panel, curve in zip(panels, CURVE_COLOURS, strict=True):
        draw_errors(panel, simulations, curve)
        panel.set_title(curve)
    drawing.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(PROFILE_COLOURS))
    panels[-1].set_xlabel("time [s]")
    return drawing


def draw_errors(axes: Axes, simulations: Mapping[PaperCase, SimulatedCase], curve: str) -> None:
    """Draw the position error of every motion profile on one curve."""
    for profile, colour in PROFILE_COLOURS.items():
        simulation = simulations[HEAVY_SCENE, profile, curve]
        axes.plot(simulation.time, 1e3 * simulation.path_error, color=colour, label=profile, linewidth=1.2)
    axes.set(ylabel="position error [mm]", xlim=(0.0, simulation.time[-1]))
    axes.set_ylim(bottom=0.0)
    mark_end(axes, simulation.duration)


PARITY = {
    "peak_torque_1": ("torque [N m]", "o"),
    "rms_acceleration_error": ("RMS acceleration error [m/s²]", "s"),
    "peak_modal_deflection_1": ("deflection [µm]", "^"),
}
"""Metric of Tables 7 and 9 → label and marker."""

ROOM_FOR_LEGEND = 1.35
"""Factor by which the axis of the errors reaches beyond them."""

UNITS = {"mm": 1e3}
"""What to multiply figures of a unit with, so that all of them share one pair of axes."""


def overview(simulations: Mapping[PaperCase, SimulatedCase], tables: Sequence[ComparisonTable]) -> Figure:
    """The picture for the README."""
    drawing = draw(11.0, 5.0)
    grid = drawing.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    _robot(drawing.add_subplot(grid[:, 0]))
    errors = drawing.add_subplot(grid[0, 1])
    draw_errors(errors, simulations, "Lamé")
    errors.set(xlabel="time [s]", title="What elasticity leaves: 6 kg in 0.43 s")
    errors.set_ylim(top=ROOM_FOR_LEGEND * errors.get_ylim()[1])
    errors.legend(loc="upper left", fontsize=8, ncols=2, handlelength=1.2, columnspacing=1.0)
    _parity(drawing.add_subplot(grid[1, 1]), tables)
    return drawing


def _robot(axes: Axes) -> None:
    motion = plan(case_scene(HEAVY_SCENE, "7th order polynomial", "Lamé"))
    for time, opacity in ((0.0, 1.0), (0.5 * motion.duration, 0.35), (motion.duration, 0.15)):
        draw_mechanism(axes, motion, time, opacity=opacity)
    draw_bases(axes, motion)
    draw_path(axes, motion)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title="The five-bar robot and its pick-and-place path", aspect="equal")
    axes.set(xlim=(-400.0, 400.0), ylim=(-85.0, 375.0))


def _parity(axes: Axes, tables: Sequence[ComparisonTable]) -> None:
    """Computed over printed figures on equal axes; a misprint is hollow."""
    # points of both tables, a colour and a marker for each metric
    chosen = [table for table in tables if table.printed.key in ("table-07", "table-09")]
    for (metric, (label, marker)), colour in zip(PARITY.items(), CURVE_COLOURS.values(), strict=True):
        cells = [
            (UNITS.get(comparison.quantity.unit, 1.0), cell)
            for comparison in (table.comparison(metric) for table in chosen)
            for cell in comparison.cells
        ]
        points = [(scale * float(cell.printed), scale * cell.computed) for scale, cell in cells if cell.believable]
        axes.loglog(
            *np.transpose(points), marker, color=colour, label=label, markersize=5, alpha=0.8, markeredgewidth=0
        )
        for scale, cell in cells:
            if not cell.believable:
                _misprint(axes, (scale * float(cell.printed), scale * cell.computed), marker, colour)
    # equal axes with the line of agreement
    limits = np.array([2.0, 220.0])
    axes.plot(limits, limits, color=GREY, linewidth=1.0, zorder=1)
    axes.set(xlim=limits, ylim=limits, xlabel="printed in the paper", ylabel="computed through the FMU")
    axes.set_title("Tables 7 and 9: 72 figures", color=INK)
    axes.legend(loc="upper left", fontsize=8)


def _misprint(axes: Axes, point: tuple[float, float], marker: str, colour: str) -> None:
    axes.loglog(*point, marker, markerfacecolor="white", markeredgecolor=colour, markersize=5)
    axes.annotate("misprint", point, xytext=(-8, -3), textcoords="offset points", ha="right", fontsize=8, color=GREY)
