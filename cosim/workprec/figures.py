"""Work-precision diagrams: error to the right, time upwards, a line for each method, failures as crosses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from flexfmu.cosim.errors import ResultsError
from flexfmu.cosim.reports.figure_style import draw, save, style
from flexfmu.cosim.workprec.point_labels import keep_apart, label_points
from flexfmu.cosim.workprec.study import FAMILIES, Study
from flexfmu.cosim.workprec.trial import Trial

TITLES = {
    "integrators": "Integrators over their tolerance or step",
    "communication": "Communication step, by degree of the inputs",
    "algorithms": "Coupling algorithms over the communication step",
    "effects": "Effects left out (error against all of them)",
    "formulations": "Formulations, SciPy's Radau",
    "tools": "Other tools, and the fastest of ours",
}
"""Family → title of its diagram."""


class PlainNumbers(LogFormatter):
    """0.1, 10 and 20 instead of powers of ten, as many as there is room for; one for each axis, whose range it follows."""

    def __init__(self) -> None:
        super().__init__(labelOnlyBase=False, minor_thresholds=(2.0, 0.5))

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


FLOOR = 1e-12
"""Errors below are drawn here: the references agree no better."""


def save_figures(study: Study, folder: Path) -> list[str]:
    """Write ``workprec.png`` with all diagrams and one picture for each family; the names.

    Raises:
        ResultsError: the folder can't be written.
    """
    names = [name for name in FAMILIES if study.family(name)]
    try:
        with style():
            for name in names:
                figure = draw(6.6, 4.8)
                draw_family(figure.subplots(), study, name)
                keep_apart(figure)
                save(figure, folder / f"workprec-{name}")
            figure = _all(study, names)
            keep_apart(figure)
            save(figure, folder / "workprec")
    except OSError as error:
        reason = error.strerror or error
        raise ResultsError(f"can't write to {folder}: {reason}; choose another folder or free some space") from error
    return names


def _all(study: Study, names: Sequence[str]) -> Figure:
    """All diagrams beside each other."""
    rows = max(1, (len(names) + 1) // 2)
    figure = draw(13.0, 4.8 * rows)
    axes = np.atleast_1d(figure.subplots(rows, 2, squeeze=False).ravel())
    for place, name in zip(axes, names, strict=False):
        draw_family(place, study, name)
    for place in axes[len(names) :]:
        place.set_axis_off()
    return figure


def lines_of(study: Study, name: str) -> dict[str, list[Trial]]:
    """Line → its trials."""
    trials = study.family(name)
    return {line: [each for each in trials if each.line == line] for line in dict.fromkeys(t.line for t in trials)}


def draw_family(axes: Axes, study: Study, name: str) -> None:
    """One diagram."""
    lines = lines_of(study, name)
    colours = colormaps["turbo"](np.linspace(0.03, 0.97, max(len(lines), 2)))
    for colour, (line, trials) in zip(colours, lines.items(), strict=False):
        good = [each for each in trials if not each.failed]
        failed = len(trials) - len(good)
        points = np.array([(max(each.error or 0.0, FLOOR), 1e3 * (each.time or 0.0)) for each in good]).reshape(-1, 2)
        label = line + (f" ({failed} failed)" if failed else "")
        axes.plot(points[:, 0], points[:, 1], "o-", color=colour, markersize=3.5, label=label)
        label_points(axes, points, [each.label for each in good])
        if failed:
            axes.plot([1.0] * failed, np.linspace(0.06, 0.2, failed), "x", color=colour, transform=axes.transAxes)
    axes.set(xscale="log", yscale="log", xlabel="error, relative to what elasticity does", ylabel="time [ms]")
    axes.yaxis.set_major_formatter(PlainNumbers())
    axes.yaxis.set_minor_formatter(PlainNumbers())
    axes.set_title(TITLES[name], fontsize=10)
    axes.legend(fontsize=6.5)
    factor = axes.secondary_yaxis(
        "right",
        functions=(
            lambda ms: 1e3 * study.duration / np.maximum(ms, 1e-9),
            lambda f: 1e3 * study.duration / np.maximum(f, 1e-9),
        ),
    )
    factor.yaxis.set_major_formatter(PlainNumbers())
    factor.yaxis.set_minor_formatter(PlainNumbers())
    factor.set_ylabel("times real time")
