"""One picture that sums the experiment up: the robot and its path, the error, and how closely the paper is met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from flexfmu.cosim.paper.cases import Case, case_scene
from flexfmu.cosim.paper.colours import CURVE_COLOURS
from flexfmu.cosim.paper.comparison import ComparisonTable
from flexfmu.cosim.paper.error_figures import SCENE, draw_errors
from flexfmu.cosim.paper.mechanism import draw_bases, draw_mechanism, draw_path
from flexfmu.cosim.paper.simulations import Simulation
from flexfmu.cosim.planning import plan
from flexfmu.cosim.reports.figure_style import GREY, INK, draw

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


def overview(simulations: Mapping[Case, Simulation], tables: Sequence[ComparisonTable]) -> Drawing:
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
    motion = plan(case_scene(SCENE, "7th order polynomial", "Lamé"))
    for time, opacity in ((0.0, 1.0), (0.5 * motion.duration, 0.35), (motion.duration, 0.15)):
        draw_mechanism(axes, motion, time, opacity=opacity)
    draw_bases(axes, motion)
    draw_path(axes, motion)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title="The five-bar robot and its pick-and-place path", aspect="equal")
    axes.set(xlim=(-400.0, 400.0), ylim=(-85.0, 375.0))


def _parity(axes: Axes, tables: Sequence[ComparisonTable]) -> None:
    """Computed over printed figures on equal axes; a misprint is hollow."""
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
    limits = np.array([2.0, 220.0])
    axes.plot(limits, limits, color=GREY, linewidth=1.0, zorder=1)
    axes.set(xlim=limits, ylim=limits, xlabel="printed in the paper", ylabel="computed through the FMU")
    axes.set_title("Tables 7 and 9: 72 figures", color=INK)
    axes.legend(loc="upper left", fontsize=8)


def _misprint(axes: Axes, point: tuple[float, float], marker: str, colour: str) -> None:
    axes.loglog(*point, marker, markerfacecolor="white", markeredgecolor=colour, markersize=5)
    axes.annotate("misprint", point, xytext=(-8, -3), textcoords="offset points", ha="right", fontsize=8, color=GREY)
