"""Work-precision diagrams: error to the right, time upwards, a line for each method, failures as crosses; as pictures, and as an
offline page on which every point shows its setting, error, time and work."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.reports.chart import PALETTE, Curve, Panel
from flexfmu.cosim.reports.figure_style import GREY, PlainNumbers, draw, save
from flexfmu.cosim.reports.page import Plot, render_page
from flexfmu.cosim.studies.workprec.study import FAMILIES, WorkPrecisionStudy, sentence
from flexfmu.cosim.studies.workprec.trial import WorkPrecisionTrial

FONT_SIZE = 5.5

PLACES = (
    (3.0, 3.0, "left", "bottom"),
    (-3.0, 3.0, "right", "bottom"),
    (3.0, -3.0, "left", "top"),
    (-3.0, -3.0, "right", "top"),
    (0.0, 5.0, "center", "bottom"),
    (0.0, -5.0, "center", "top"),
    (6.0, 0.0, "left", "center"),
    (-6.0, 0.0, "right", "center"),
    (0.0, 12.0, "center", "bottom"),
    (0.0, -12.0, "center", "top"),
)
"""Where a label may stand: from its point [pt], and which side or corner of the text is there; the usual place first."""

END, MIDDLE = "end", "middle"
"""Places of a label on its line."""

DARKER = 0.75
"""Of the colour of a line in its labels, which are thin."""

CLEARANCE = 2.0
"""Around every point [px]."""

Box = tuple[float, float, float, float]
"""Left, bottom, right, top [px]."""


def label_points(axes: Axes, points: RealArray, texts: Sequence[str], colour: Any = GREY) -> None:
    """Write a text beside each of the points, shape (n, 2), in the usual place, in the colour of their line."""
    x, y, across, upright = PLACES[0]
    for k, (point, text) in enumerate(zip(points, texts, strict=True)):
        label = axes.annotate(text, point, (x, y), textcoords="offset points", ha=across, va=upright)
        label.set(fontsize=FONT_SIZE, color=colour, gid=END if k in (0, len(texts) - 1) else MIDDLE)


def keep_apart(figure: Figure) -> None:
    """Move the labels of all diagrams where they cover neither each other nor points, lines or legend.

    A label for which there is no such place is left out; tables have all settings. The ends of lines come first.
    """
    figure.draw_without_rendering()  # sizes are known from here on
    for axes in figure.axes:
        taken = []
        if (legend := axes.get_legend()) is not None:
            taken.append(_box(legend))
            legend.set_loc(tuple(axes.transAxes.inverted().transform(taken[0][:2])))  # it would follow the labels
        points, lines = _drawn(axes)
        taken += [(x - CLEARANCE, y - CLEARANCE, x + CLEARANCE, y + CLEARANCE) for x, y in points]
        labels = [each for each in axes.texts if isinstance(each, Annotation)]
        for label in sorted(labels, key=lambda each: each.get_gid() != END):
            box = _move(label, _box(axes), taken, lines)
            label.set_visible(box is not None)
            taken += [box] if box is not None else []


def _move(label: Annotation, frame: Box, taken: Sequence[Box], lines: RealArray) -> Box | None:
    """Put a label into the first place that is free, the usual one first; None where every place is taken."""
    for x, y, across, upright in PLACES:
        label.xyann = (x, y)
        label.set(ha=across, va=upright)
        left, bottom, right, top = box = _box(label)
        # within the diagram, and apart from all that is there
        inside = left >= frame[0] and bottom >= frame[1] and right <= frame[2] and top <= frame[3]
        covers = any(left < x1 and x0 < right and bottom < y1 and y0 < top for x0, y0, x1, y1 in taken)
        if inside and not covers and not ((lines > box[:2]) & (lines < box[2:])).all(axis=1).any():
            return box
    return None


def _box(artist: Any) -> Box:
    """The area of an artist."""
    return tuple(artist.get_window_extent().extents)


def _drawn(axes: Axes) -> tuple[RealArray, RealArray]:
    """All points of the lines, and places along the lines, each of shape (n, 2) [px]."""
    points, places = [np.empty((0, 2))], [np.empty((0, 2))]
    for line in axes.lines:
        corners = line.get_transform().transform(np.column_stack(line.get_data()).astype(float))
        points.append(corners)
        for start, end in pairwise(corners):
            shares = np.linspace(0.0, 1.0, 1 + int(np.hypot(*(end - start))))[:, np.newaxis]
            places.append((1.0 - shares) * start + shares * end)
    return np.concatenate(points), np.concatenate(places)


TITLES = {
    "integrators": "Integrators over their tolerance or step",
    "communication": "Communication step, by degree of the inputs",
    "algorithms": "Coupling algorithms over the communication step",
    "effects": "Effects left out (error against all of them)",
    "formulations": "Formulations, SciPy's Radau",
    "tools": "Other tools, and the fastest of ours",
}
"""Family → title of its diagram."""


PLOT_HEIGHT = 320.0
"""Of a diagram of the page [pt]."""

FLOOR = 1e-12
"""Errors below are drawn here: the references agree no better."""


def save_figures(study: WorkPrecisionStudy, folder: Path) -> list[str]:
    """Write ``workprec.png`` with all diagrams and one picture for each family; the names.

    Raises:
        ResultsError: the folder can't be written.
    """
    names = [name for name in FAMILIES if study.family(name)]
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
    keep_apart(figure)
    return figure


def _points(trials: Sequence[WorkPrecisionTrial]) -> RealArray:
    """Error and time [ms] of each trial, (n, 2)."""
    return np.array([(max(each.error or 0.0, FLOOR), 1e3 * (each.time or 0.0)) for each in trials]).reshape(-1, 2)


def lines_of(study: WorkPrecisionStudy, name: str) -> dict[str, list[WorkPrecisionTrial]]:
    """Line → its trials."""
    trials = study.family(name)
    return {line: [each for each in trials if each.line == line] for line in dict.fromkeys(t.line for t in trials)}


def draw_family(axes: Axes, study: WorkPrecisionStudy, name: str) -> None:
    """One diagram."""
    # a line for each method; failures as crosses at the right
    lines = lines_of(study, name)
    colours = colormaps["turbo"](np.linspace(0.03, 0.97, max(len(lines), 2)))
    for colour, (line, trials) in zip(colours, lines.items(), strict=False):
        good = [each for each in trials if not each.failed]
        failed = len(trials) - len(good)
        points = _points(good)
        label = line + (f" ({failed} failed)" if failed else "")
        axes.plot(points[:, 0], points[:, 1], "o-", color=colour, markersize=3.5, label=label)
        label_points(axes, points, [each.label for each in good], DARKER * colour[:3])
        if failed:
            axes.plot([1.0] * failed, np.linspace(0.06, 0.2, failed), "x", color=colour, transform=axes.transAxes)
    # axes, and real time at the right
    axes.set(xscale="log", yscale="log", xlabel="error, relative to the largest elastic deviation", ylabel="time [ms]")
    axes.set_title(TITLES[name], fontsize=10)
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
    plots = [_plot(study, name) for name in FAMILIES if study.family(name)]
    return render_page(f"Work and precision: {study.scene.name}", sentence(study), plots)


def _plot(study: WorkPrecisionStudy, name: str) -> Plot:
    curves = []
    for number, (line, trials) in enumerate(lines_of(study, name).items()):
        colour, dashes = PALETTE[number % len(PALETTE)], "5,3" if number >= len(PALETTE) else ""
        good, failed = ([each for each in trials if each.failed is wanted] for wanted in (False, True))
        points = _points(good)
        notes = [
            f"{each.label}: {study.duration / (each.time or 1.0):.3g} times real time. {each.note}" for each in good
        ]
        curves.append(Curve(points[:, 0], points[:, 1], line, colour, dot="disc", notes=notes, dashes=dashes))
        # what failed, at real time and an error of 1
        if failed:
            place, notes = np.ones(len(failed)), [f"{each.label} failed: {each.note}" for each in failed]
            times = 1e3 * study.duration * place
            curves.append(Curve(place, times, f"{line}, failed", colour, width=0.0, dot="cross", notes=notes))
    label = "error, relative to the largest elastic deviation"
    panel = Panel(label="time [ms]", curves=curves, logarithmic="xy", is_function=False)
    return Plot(f"workprec-{name}", TITLES[name], "Lower left is better.", (panel,), label, PLOT_HEIGHT)
