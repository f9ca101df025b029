"""Style of figures in files; no windows, no global state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from flexfmu.cosim.engine.drawing import NotebookFigure
from flexfmu.cosim.engine.files import replacing

INK, GREY, PALE = "#22303c", "#7b8794", "#e6eaee"
"""Colours of text and mechanism, of secondary lines, and of fills."""

_RC: Mapping[str, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "svg.hashsalt": "flexfmu",  # equal figures give equal files
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
        with replacing(stem.with_suffix(".png")) as path:
            figure.savefig(path, format="png", dpi=150, metadata={"Software": None})
        with replacing(stem.with_suffix(".svg")) as path:
            figure.savefig(path, format="svg", metadata={"Date": None})


def mark_end(axes: Axes, duration: float, text: str = "end of motion") -> None:
    """Draw a dashed vertical line with a label at the end of the motion, ``duration`` in the axes' unit of time."""
    axes.axvline(duration, color=GREY, linewidth=1.0, linestyle=(0, (4, 3)))
    axes.annotate(
        text,
        (duration, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(4, -3),
        textcoords="offset points",
        va="top",
        fontsize=8,
        color=GREY,
    )


class PlainNumbers(LogFormatter):
    """0.1, 10 and 20 instead of powers of ten, as many as there is room for; each axis needs its own formatter, which follows its range."""

    def __init__(self) -> None:
        super().__init__(labelOnlyBase=False, minor_thresholds=(2.0, 0.5))

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def logarithmic(axes: Axes) -> None:
    """Make the vertical axis logarithmic, with plain numbers."""
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(PlainNumbers())
    axes.yaxis.set_minor_formatter(PlainNumbers())
