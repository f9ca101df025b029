"""Elements of SVG as text: lines, signs and texts of charts."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from flexfmu.cosim.engine.slave import RealArray

INK, GREY, PALE = "var(--ink)", "var(--grey)", "var(--line)"
FIRST, SECOND = "var(--first)", "var(--second)"
PALETTE = (FIRST, SECOND, *(f"var(--{name})" for name in ("third", "fourth", "fifth", "sixth", "seventh", "eighth")))
"""Colours: variables that the page defines (``templates/page.css``)."""

RESOLUTION = 0.1
"""To which points of curves are rounded."""


def path(x: RealArray, y: RealArray) -> str:
    """Return a path through points (N,), rounded, without those that change nothing, in one piece for each finite stretch."""
    finite = np.isfinite(x) & np.isfinite(y)
    edges = np.flatnonzero(np.diff(finite, prepend=False, append=False))
    pieces = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        points = np.rint(np.clip(np.stack([x[begin:end], y[begin:end]], axis=1), -1e4, 1e4) / RESOLUTION)
        # repeated points, then those on the straight line between their neighbours
        points = points[np.concatenate([[True], np.any(np.diff(points, axis=0) != 0.0, axis=1)])]
        steps = np.diff(points, axis=0)
        turns = steps[:-1, 0] * steps[1:, 1] != steps[:-1, 1] * steps[1:, 0]
        backwards = np.sum(steps[:-1] * steps[1:], axis=1) < 0.0
        points = points[np.concatenate([[True], turns | backwards, [True]])[: len(points)]] * RESOLUTION
        pieces.append("M" + " ".join(["%.1f %.1f"] * len(points)) % tuple(points.ravel().tolist()))
    return "".join(pieces)


def signs(x: RealArray, y: RealArray, dot: str) -> str:
    """Return the path of a disc (drawn by a round line without length) or a cross at each of the points (N,)."""
    sign = "h0" if dot == "disc" else "m-2.5-2.5l5 5m0-5l-5 5"
    points = np.stack([x, y], axis=1)[np.isfinite(x) & np.isfinite(y)]
    return "".join(f"M{left:.1f} {down:.1f}{sign}" for left, down in points.tolist())


def line(
    d: str, colour: str, width: float, opacity: float = 1.0, *, cap: str = "butt", dashes: str = "", extra: str = ""
) -> str:
    """Return a path without filling; ``extra`` attributes start with a space."""
    style = f'stroke="{colour}" stroke-width="{width:g}" stroke-linecap="{cap}" stroke-linejoin="round"'
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
    faint = f' stroke-opacity="{opacity:g}"' if opacity < 1.0 else ""
    return f'<path{extra} d="{d}" fill="none" {style}{dashed}{faint}/>'


def attributes(data: Mapping[str, str]) -> str:
    """Return attributes ``data-name``."""
    return "".join(f' data-{name}="{escape(value)}"' for name, value in data.items())


def text(content: str, x: float, y: float, size: float, anchor: str, colour: str = INK, *, upright: bool = True) -> str:
    """Return a text with its baseline's start, middle or end at a point."""
    turned = "" if upright else f' transform="rotate(-90 {x:.2f} {y:.2f})"'
    place = f'x="{x:.2f}" y="{y:.2f}" font-size="{size:g}" text-anchor="{anchor}" fill="{colour}"{turned}'
    return f"<text {place}>{escape(content)}</text>"
