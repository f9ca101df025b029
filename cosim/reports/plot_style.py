"""How plots look: drawings without window or global state, as SVG whose colours follow the page's light or dark theme."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

import matplotlib
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, GREY, PALE = "#010203", "#040506", "#070809"
FIRST, SECOND, THIRD = "#0a0b0c", "#0d0e0f", "#101112"

THEME: Mapping[str, str] = {
    INK: "var(--ink)",
    GREY: "var(--grey)",
    PALE: "var(--line)",
    FIRST: "var(--first)",
    SECOND: "var(--second)",
    THIRD: "var(--third)",
}
"""Placeholder colour in a drawing → CSS variable of the page (defined in ``templates/report.html.j2``)."""

_RC: Mapping[str, Any] = {
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.edgecolor": GREY,
    "axes.facecolor": "none",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.prop_cycle": cycler(color=[FIRST, SECOND, THIRD]),
    "figure.facecolor": "none",
    "grid.color": PALE,
    "grid.linewidth": 0.8,
    "text.color": INK,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "path.simplify_threshold": 0.2,
    "svg.fonttype": "none",  # text stays text, in the page's font
    "svg.hashsalt": "flexfmu",  # the same plot is the same file
}


def style() -> AbstractContextManager[None]:
    """Context in which drawings are made and turned into SVG."""
    context: AbstractContextManager[None] = matplotlib.rc_context(dict(_RC))
    return context


def draw(width: float, height: float) -> Figure:
    """An empty drawing of ``width`` by ``height`` inches."""
    return Figure(figsize=(width, height), layout="constrained")


def to_svg(drawing: Figure, key: str, title: str) -> str:
    """The drawing as an SVG element for a page, its identifiers prefixed by ``key``, with a title for screen readers."""
    buffer = io.StringIO()
    drawing.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\b(id="|href="#|url\(#)', rf"\g<1>{key}-", text)
    for placeholder, variable in THEME.items():
        text = text.replace(placeholder, variable)
    opening = re.match(r"<svg[^>]*>", text)
    size = re.search(r'viewBox="[^"]*"', text)
    if opening is None or size is None:
        raise RuntimeError("matplotlib wrote an SVG without a view box")
    head = f'<svg {size[0]} role="img" aria-label="{title}">'
    return head + text[opening.end() :]


def mark_time(axes: Axes, time: float, text: str) -> None:
    """A dashed vertical line with a label at a time [s]."""
    axes.axvline(time, color=GREY, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.annotate(
        text,
        (time, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        fontsize=8,
        color=GREY,
    )
