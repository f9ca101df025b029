"""Style of figures in files, and in HTML pages as SVG that follows the light or dark theme; no windows, no global state."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, GREY, PALE = "#22303c", "#7b8794", "#e6eaee"
"""Colours of text and mechanism, of secondary lines, and of fills."""

_COMMON: Mapping[str, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "svg.hashsalt": "flexfmu",  # equal figures give equal files
}
"""Settings of matplotlib for figures both in files and in pages."""

_RC: Mapping[str, Any] = {
    **_COMMON,
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
    """Return an empty drawing that belongs to no window and no global state; call it within `style` or `page_style`.

    Args:
        width, height: size in inches.
    """
    return Figure(figsize=(width, height), layout="constrained")


def style() -> AbstractContextManager[None]:
    """Return the context in which figures for files are drawn and saved."""
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


PAGE_INK, PAGE_GREY, PAGE_PALE = "#010203", "#040506", "#070809"
FIRST, SECOND, THIRD = "#0a0b0c", "#0d0e0f", "#101112"

THEME: Mapping[str, str] = {
    PAGE_INK: "var(--ink)",
    PAGE_GREY: "var(--grey)",
    PAGE_PALE: "var(--line)",
    FIRST: "var(--first)",
    SECOND: "var(--second)",
    THIRD: "var(--third)",
}
"""Placeholder colour in a drawing → CSS variable of the page (defined in ``templates/report.html.j2``)."""

_PAGE_RC: Mapping[str, Any] = {
    **_COMMON,
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.edgecolor": PAGE_GREY,
    "axes.facecolor": "none",
    "axes.labelcolor": PAGE_INK,
    "axes.linewidth": 0.8,
    "axes.prop_cycle": cycler(color=[FIRST, SECOND, THIRD]),
    "figure.facecolor": "none",
    "grid.color": PAGE_PALE,
    "text.color": PAGE_INK,
    "xtick.color": PAGE_GREY,
    "ytick.color": PAGE_GREY,
    "xtick.labelcolor": PAGE_INK,
    "ytick.labelcolor": PAGE_INK,
    "lines.linewidth": 1.4,
    "legend.fontsize": 8.5,
    "path.simplify_threshold": 0.2,
    "svg.fonttype": "none",  # text stays text, in the page's font
}


def page_style() -> AbstractContextManager[None]:
    """Return the context in which drawings for pages are made and converted to SVG."""
    context: AbstractContextManager[None] = matplotlib.rc_context(dict(_PAGE_RC))
    return context


def to_svg(drawing: Figure, key: str, title: str) -> str:
    """Return the drawing as an SVG element for a page: identifiers prefixed by ``key``, ``title`` for screen readers."""
    buffer = io.StringIO()
    drawing.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    # only the SVG element, with identifiers unique in the page and colours of its theme
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\b(id="|href="#|url\(#)', rf"\g<1>{key}-", text)
    for placeholder, variable in THEME.items():
        text = text.replace(placeholder, variable)
    # the page sets the size; screen readers read the title
    opening = re.match(r"<svg[^>]*>", text)
    size = re.search(r'viewBox="[^"]*"', text)
    if opening is None or size is None:
        raise RuntimeError("matplotlib wrote an SVG without a view box")
    head = f'<svg {size[0]} role="img" aria-label="{title}">'
    return head + text[opening.end() :]


def mark_time(axes: Axes, time: float, text: str) -> None:
    """Draw a dashed vertical line with a label at a time [s]."""
    axes.axvline(time, color=PAGE_GREY, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.annotate(
        text,
        (time, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        fontsize=8,
        color=PAGE_GREY,
    )
