"""Path-tracking error in the task space (Fig. 12)."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from flexfmu.cosim.paper.cases import Case
from flexfmu.cosim.paper.colours import CURVE_COLOURS, PROFILE_COLOURS
from flexfmu.cosim.paper.simulations import Simulation
from flexfmu.cosim.reports.figure_style import draw, mark_end

SCENE = "barnard2012-6kg"


def path_errors(simulations: Mapping[Case, Simulation]) -> Drawing:
    """Fig. 12: norm of the position error for the payload of 6 kg, one panel for each curve."""
    drawing = draw(7.6, 8.2)
    panels = drawing.subplots(3, 1, sharex=True, sharey=True)
    for panel, curve in zip(panels, CURVE_COLOURS, strict=True):
        draw_errors(panel, simulations, curve)
        panel.set_title(curve)
    drawing.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(PROFILE_COLOURS))
    panels[-1].set_xlabel("time [s]")
    return drawing


def draw_errors(axes: Axes, simulations: Mapping[Case, Simulation], curve: str) -> None:
    """Draw the position error of every motion profile on one curve."""
    for profile, colour in PROFILE_COLOURS.items():
        simulation = simulations[SCENE, profile, curve]
        axes.plot(simulation.time, 1e3 * simulation.path_error, color=colour, label=profile, linewidth=1.2)
    axes.set(ylabel="position error [mm]", xlim=(0.0, simulation.time[-1]))
    axes.set_ylim(bottom=0.0)
    mark_end(axes, simulation.duration)
