"""Work-precision diagrams: error to the right, time upwards, a line for each method, failures as crosses; as pictures, and as an
offline page on which every point shows its setting, error, time and work."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexfmu.cosim.experiment.accuracy import WorkPrecisionTrial
from flexfmu.cosim.metrics.metric_table import definition
from flexfmu.cosim.reports.figure_style import PlainNumbers, draw, save
from flexfmu.cosim.reports.page import TILES, Page, Plot
from flexfmu.cosim.reports.report import of_scene
from flexfmu.cosim.reports.work_precision import FLOOR, FRONT, by_line, diagram, fronts, points
from flexfmu.cosim.studies.workprec.study import WorkPrecisionStudy, cheapest, sentence

FONT_SIZE = 5.5
"""Of labels, which the ends of a line have; the page shows all settings."""

FINE = 1e-4
"""Error of the settings that stand at the top of the page."""

DARKER = 0.75
"""Of the colour of a line in its labels, which are thin."""

TITLES = {
    "integrators": "Integrators over their tolerance or step",
    "communication": "Communication step, by degree of the inputs",
    "algorithms": "Coupling algorithms over the communication step",
    "effects": "Effects left out (error against all of them)",
    "formulations": "Formulations, SciPy's Radau",
    "tools": "Other tools, and the fastest of ours",
}
"""Family → title of its diagram."""


def save_figures(study: WorkPrecisionStudy, folder: Path) -> list[str]:
    """Write ``workprec.png`` with all diagrams and one picture for each family; the names.

    Raises:
        ResultsError: the folder can't be written.
    """
    names = list(study.families)
    # a picture of each, and all diagrams beside each other
    for name in names:
        save(partial(_picture, study, [name], 6.6), folder / f"workprec-{name}")
    save(partial(_picture, study, names, 6.5), folder / "workprec")
    return names


def _picture(study: WorkPrecisionStudy, names: Sequence[str], width: float) -> Figure:
    """The diagrams of some families, two in a row, each of this width."""
    columns, rows = min(2, max(len(names), 1)), max(1, -(-len(names) // 2))
    figure = draw(width * columns, 4.8 * rows)
    places = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, name in zip(places, names, strict=False):
        draw_family(place, study, name)
    for place in places[len(names) :]:
        place.set_axis_off()
    return figure


def lines_of(study: WorkPrecisionStudy, name: str) -> dict[str, list[WorkPrecisionTrial]]:
    """Line → its trials; of sets of effects the settings of each that none of it beats, its failures, and the front."""
    return (fronts if study.is_ladder(name) else by_line)(study.family(name))


def _title(study: WorkPrecisionStudy, name: str) -> tuple[str, str]:
    """Title of a diagram, and label of its horizontal axis."""
    title = TITLES[name] if name in TITLES else f"{definition(name).label}: time over error, by set of effects"
    return title, "relative error, beside the richest model" if study.is_ladder(
        name
    ) else "error, relative to the largest elastic deviation"


def draw_family(axes: Axes, study: WorkPrecisionStudy, name: str) -> None:
    """One diagram."""
    # a line for each method; failures as crosses at the right
    lines = lines_of(study, name)
    colours = colormaps["turbo"](np.linspace(0.03, 0.97, max(len(lines), 2)))
    for colour, (line, trials) in zip(colours, lines.items(), strict=False):
        good = [each for each in trials if not each.failed]
        failed = len(trials) - len(good)
        places = points(good)
        label = line + (f" ({failed} failed)" if failed else "")
        axes.plot(places[:, 0], places[:, 1], "o-", color=colour, markersize=3.5, label=label)
        if line == FRONT:
            axes.lines[-1].set(color="black", linewidth=0.9, markersize=2.0)
        for place in {0, len(good) - 1} if good and (not study.is_ladder(name) or line == FRONT) else ():
            label_style: dict[str, Any] = {"fontsize": FONT_SIZE, "color": DARKER * colour[:3]}
            label_style["ha"] = "left" if place == 0 or line != FRONT else "right"
            axes.annotate(good[place].label, places[place], (3.0, 3.0), textcoords="offset points", **label_style)
        if (floor := study.floors.get((name, line), 0.0)) > FLOOR:
            axes.axvline(floor, color=colour, linestyle=":", linewidth=0.8)
        if failed:
            axes.plot([1.0] * failed, np.linspace(0.06, 0.2, failed), "x", color=colour, transform=axes.transAxes)
    # axes, and real time at the right
    title, label = _title(study, name)
    axes.set(xscale="log", yscale="log", xlabel=label, ylabel="time [ms]")
    axes.set_title(title, fontsize=10)
    axes.legend(fontsize=6.5)

    def inverse(value: Any) -> Any:
        return 1e3 * study.duration / np.maximum(value, 1e-9)

    factor = axes.secondary_yaxis("right", functions=(inverse, inverse))
    factor.set_ylabel("times real time")
    for axis in (axes.yaxis, factor.yaxis):
        axis.set_major_formatter(PlainNumbers())
        axis.set_minor_formatter(PlainNumbers())


def html(study: WorkPrecisionStudy) -> str:
    """Return the page: a diagram for each family, in which every point shows its setting, error, time and work."""
    plots, tiles = [_plot(study, name) for name in study.families], list[tuple[str, Sequence[str]]]()
    for name in study.families:
        if (best := cheapest(study.family(name), FINE)) is not None:
            label = (
                f"{_title(study, name)[0].partition(' over ')[0]}, fastest within {FINE:g}: {best.line}, {best.label}"
            )
            tiles.append((label, [f"{1e3 * (best.time or 0.0):.3g} ms"]))
    return Page(
        f"Work and precision: {study.scene.name}", sentence(study), plots, tiles=tiles[:TILES], **of_scene(study.scene)
    ).html


def _plot(study: WorkPrecisionStudy, name: str) -> Plot:
    marks = [(floor, line) for (metric, line), floor in study.floors.items() if metric == name and floor > FLOOR]
    title, label = _title(study, name)
    text = "Lower left is better." + (" Dashed: the error of a set of effects itself." if marks else "")
    return diagram(f"workprec-{name}", (title, text, label), lines_of(study, name), study.duration, marks)
