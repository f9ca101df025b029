"""Work-precision diagrams: error to the right, time upwards, a line for each method, failures as crosses; as pictures, and as an
offline page on which every point shows its setting, error, time and work."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure

from flexfmu.cosim.experiment.accuracy import WorkPrecisionTrial
from flexfmu.cosim.metrics.metric_table import definition
from flexfmu.cosim.reports.chart import Marker
from flexfmu.cosim.reports.figure_style import PlainNumbers, figure_of, save
from flexfmu.cosim.reports.page import TILES, Page, Plot
from flexfmu.cosim.reports.report import of_scene
from flexfmu.cosim.reports.work_precision import FLOOR, FRONT, by_line, diagram, fronts, points
from flexfmu.cosim.studies.workprec.study import WorkPrecisionStudy, cheapest, sentence

FINE = 1e-4
"""Error of the settings that stand at the top of the page."""

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
        save(partial(picture, study, [name]), folder / f"workprec-{name}")
    save(partial(picture, study, names), folder / "workprec")
    return names


def picture(study: WorkPrecisionStudy, names: Sequence[str]) -> Figure:
    """The diagrams of some families, two in a row, with labels at the ends of lines, and real time at the right."""
    figure = figure_of([_plot(study, name, with_ends=True) for name in names], columns=2)

    def inverse(value: Any) -> Any:
        return 1e3 * study.duration / np.maximum(value, 1e-9)

    for axes in figure.axes:
        factor = axes.secondary_yaxis("right", functions=(inverse, inverse))
        factor.set_ylabel("times real time")
        factor.yaxis.set_major_formatter(PlainNumbers())
        factor.yaxis.set_minor_formatter(PlainNumbers())
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
        f"Work and precision: {study.scene.name}",
        [sentence(study)],
        plots,
        tiles=tiles[:TILES],
        **of_scene(study.scene),
    ).html


def _plot(study: WorkPrecisionStudy, name: str, *, with_ends: bool = False) -> Plot:
    marks = [(floor, line) for (metric, line), floor in study.floors.items() if metric == name and floor > FLOOR]
    (title, label), lines, markers = _title(study, name), lines_of(study, name), list[Marker]()
    text = "Lower left is better." + (" Dashed: the error of a set of effects itself." if marks else "")
    # the settings at the ends of lines, of sets of effects those of the front
    is_ladder = study.is_ladder(name)
    for trials in [lines[FRONT]] if is_ladder else lines.values():
        good = [each for each in trials if not each.failed]
        ends = {0, len(good) - 1} if good and with_ends else set[int]()
        for end in ends:
            anchor: Literal["start", "end"] = "end" if end and is_ladder else "start"
            x, y = points(good)[end].tolist()
            markers.append(Marker(x, y, text=good[end].label, offset=(4.0, -4.0), anchor=anchor))
    return diagram(f"workprec-{name}", (title, text, label), lines, study.duration, marks, markers)
