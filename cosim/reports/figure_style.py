"""Figures in files and notebooks: the plots of pages as Matplotlib draws them, in one style; no windows, no global state."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from importlib.resources import files
from math import isfinite
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.rcsetup import cycler
from matplotlib.ticker import LogFormatter, MaxNLocator

from flexfmu.cosim.engine.drawing import NotebookFigure
from flexfmu.cosim.engine.files import replacing
from flexfmu.cosim.reports import chart
from flexfmu.cosim.reports.page import Plot

INK, GREY, PALE = "#22303c", "#7b8794", "#e6eaee"
"""Colours of text and mechanism, of secondary lines, and of fills."""

_LIGHT = files("flexfmu.cosim.reports").joinpath("templates/page.css").read_text(encoding="utf-8").partition("}")[0]
COLOURS = {f"var({name})": colour for name, colour in re.findall(r"(--\w+): (#\w+)", _LIGHT)}
"""Variable of a page → its colour on white."""

WIDTH, HEADING, TITLE = 460.0, 58.0, 26.0
"""Width of a plot, height of what stands above and below its panels and of a figure's title [pt]."""

LETTERS, BOLD = 92, 64
"""Letters across a plot's legend, and across its title."""

STAIRS = 6
"""Heights at which the texts of marks stand, one after the other."""

DASHES = (0.0, (4.0, 3.0))
"""Of levels and marks."""

_RC: Mapping[str, Any] = {
    "axes.prop_cycle": cycler(color=[COLOURS[each] for each in chart.PALETTE]),
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "svg.hashsalt": "flexfmu",  # equal figures give equal files
    "path.simplify_threshold": 0.3,  # of a point: smaller SVG files
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "grid.color": PALE,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "lines.linewidth": 1.6,
    "savefig.facecolor": "white",
}


def draw(width: float, height: float) -> Figure:
    """Return an empty drawing that belongs to no window and no global state, which notebooks show; call it within `style`.

    Args:
        width, height: size in inches.
    """
    return NotebookFigure(figsize=(width, height), layout="constrained")


def style() -> AbstractContextManager[None]:
    """Return the context in which figures for files are drawn and saved."""
    context: AbstractContextManager[None] = matplotlib.rc_context(dict(_RC))
    return context


def save(drawing: Callable[[], Figure], stem: Path) -> None:
    """Draw a figure in the `style` of files, and write it as ``<stem>.png`` at 150 dpi and as ``<stem>.svg``, without a date in them.

    Raises:
        ResultsError: a file can't be written.
    """
    with style():
        figure = drawing()
        for kind, nothing in (("png", "Software"), ("svg", "Date")):
            with replacing(stem.with_suffix(f".{kind}")) as path:
                figure.savefig(path, format=kind, dpi=150, metadata={nothing: None})


def figure_of(plots: Iterable[Plot], title: str = "", columns: int = 1) -> Figure:
    """Return plots as one figure, the panels of each below each other, with their common legend above.

    Args:
        plots: without any the figure is empty.
        title: of the figure; empty for none.
        columns: number of plots beside each other.
    """
    shown = [*plots]
    columns = max(1, min(columns, len(shown)))
    rows = [shown[k : k + columns] for k in range(0, len(shown), columns)]
    heights = [max(max(each.height, 80.0 * len(each.panels)) for each in row) + HEADING for row in rows] or [HEADING]
    with style():
        figure = draw(columns * WIDTH / 72.0, (sum(heights) + TITLE * bool(title)) / 72.0)
        figure.suptitle(title, fontsize=10, wrap=True)
        grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
        for number, plot in enumerate(shown):
            cells, labelled = grid[divmod(number, columns)].subgridspec(len(plot.panels), 1), dict[str, Any]()
            panels = [figure.add_subplot(cells[0, 0])]
            panels += [figure.add_subplot(cells[k, 0], sharex=panels[0]) for k in range(1, len(plot.panels))]
            for axes, panel in zip(panels, plot.panels, strict=True):
                draw_panel(axes, panel, plot.x_label if axes is panels[-1] else "")
                axes.tick_params(which="both", labelbottom=axes is panels[-1])
                for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                    labelled.setdefault(fill(label, LETTERS), handle)
            # the legend stands above, where no curve is, with the title
            if labelled:
                panels[0].legend(
                    labelled.values(), labelled.keys(), title=fill(plot.title, BOLD), title_fontproperties={"weight": "bold", "size": 10},
                    alignment="left", loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, borderpad=0.0, fontsize=8,
                    ncols=max(1, LETTERS // (8 + max(map(len, labelled)))),
                )  # fmt: skip
            else:
                panels[0].set_title(fill(plot.title, BOLD))
    return figure


def draw_panel(axes: Axes, panel: chart.Panel, x_label: str = "") -> None:
    """Draw a panel of a page on axes."""
    for curve in (each for each in panel.curves if each.x.size):
        colour, label = COLOURS.get(curve.colour, curve.colour), curve.label or None
        sign, size = {"": ("", 0.0), "disc": ("o", 4.5), "cross": ("x", 6.0)}[curve.dot]
        line = ((0.0, curve.dashes) if curve.dashes else "-") if curve.width else "none"
        axes.plot(
            curve.x, curve.y, color=colour, linewidth=curve.width, linestyle=line, alpha=curve.opacity, marker=sign, markersize=size,
            label=None if curve.fill else label,
        )  # fmt: skip
        if curve.fill:
            axes.fill(curve.x, curve.y, color=colour, alpha=curve.fill, linewidth=0.0, label=label)
    # levels and marks with their texts at the top, in turn lower
    if panel.level is not None and isfinite(panel.level):
        axes.axhline(panel.level, color=GREY, linewidth=1.0, linestyle=DASHES)
    # in front of the lines that they cross
    halo = withStroke(linewidth=2.0, foreground="white")
    small: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8, "path_effects": [halo]}
    for number, (x, text) in enumerate(panel.marks):
        axes.axvline(x, color=GREY, linewidth=1.0, linestyle=DASHES)
        below = (3.0, -3.0 - 10.0 * (number % STAIRS))
        axes.annotate(text, (x, 1.0), below, xycoords=("data", "axes fraction"), va="top", color=GREY, **small)
    for each in panel.markers:
        colour, sign = COLOURS.get(each.colour, each.colour), {"disc": "o", "square": "s"}[each.shape]
        if each.size:
            axes.plot(each.x, each.y, sign, markersize=0.8 * each.size, color=colour, alpha=each.opacity, mew=0.0)
        across = {"start": "left", "middle": "center", "end": "right"}[each.anchor]
        axes.annotate(each.text, (each.x, each.y), (each.offset[0], -each.offset[1]), ha=across, color=colour, **small)
    # axes
    axes.margins(x=0.01 if panel.is_function else 0.05)
    for name, axis, least in zip("xy", (axes.xaxis, axes.yaxis), np.asarray(axes.dataLim.minpos), strict=True):
        if name in panel.logarithmic and isfinite(least):
            axes.set(**{f"{name}scale": "log"})
            # 4 and 6 have no room beside each other
            axis.set_major_formatter(PlainNumbers("46" if name == "x" else ""))
            axis.set_minor_formatter(PlainNumbers("46" if name == "x" else ""))
    if "°" in panel.label:
        axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 1.5, 3, 4.5, 9, 10]))
    if panel.limits is not None:
        axes.set_xlim(panel.limits)
    if panel.least is not None:
        axes.set_ylim(bottom=panel.least)
    if panel.is_to_scale:
        axes.set_aspect("equal")
    axes.set(xlabel=x_label, ylabel=panel.label)


class PlainNumbers(LogFormatter):
    """0.1, 10 and 20 instead of powers of ten, as many as there is room for; each axis needs its own formatter, which follows its range."""

    def __init__(self, skipped: str = "") -> None:
        """Leave out numbers that begin with some digits."""
        super().__init__(labelOnlyBase=False, minor_thresholds=(2.0, 0.5))
        self.skipped = skipped

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) and f"{x:e}"[0] not in self.skipped else ""
