"""How figures in files look: one style, without window or global state."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, GREY, PALE = "#22303c", "#7b8794", "#e6eaee"
"""Text and mechanism, secondary lines, fills."""

_RC: Mapping[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": PALE,
    "grid.linewidth": 0.8,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "savefig.facecolor": "white",
    "svg.hashsalt": "flexfmu",  # the same figure is the same file
}


def draw(width: float, height: float) -> Figure:
    """An empty drawing in the common style; it belongs to no window and no global state.

    Args:
        width, height: size in inches.
    """
    return Figure(figsize=(width, height), layout="constrained")


def style() -> AbstractContextManager[None]:
    """Context in which figures are made and saved."""
    context: AbstractContextManager[None] = matplotlib.rc_context(dict(_RC))
    return context


def save(drawing: Figure, stem: Path) -> None:
    """Write a drawing as ``<stem>.png`` at 150 dpi and as ``<stem>.svg``, without a date in them.

    Raises:
        OSError: the folder can't be written.
    """
    stem.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(stem.with_suffix(".png"), dpi=150, metadata={"Software": None})
    drawing.savefig(stem.with_suffix(".svg"), metadata={"Date": None})


def mark_end(axes: Axes, duration: float, text: str = "end of motion") -> None:
    """Draw a dashed line where the motion ends [in the axes' unit of time]."""
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
