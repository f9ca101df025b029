"""What charts of a page show: uPlot draws it (`templates/page.js`), and a plain picture stands in pages without scripts.

Matplotlib would take longer to load than a scene takes to run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.cosim.engine.slave import RealArray

INK, GREY = "var(--ink)", "var(--grey)"
FIRST, SECOND = "var(--first)", "var(--second)"
PALETTE = (FIRST, SECOND, *(f"var(--{name})" for name in ("third", "fourth", "fifth", "sixth", "seventh", "eighth")))
"""Colours: variables that the page defines (``templates/page.css``)."""

MOST_POINTS = 2000
"""Largest number of points of a curve that a page has, in any page."""

PLAIN_POINTS = 160
"""Largest number of points of a curve in a picture without scripts, about."""

MANY = 20.0
"""Ratio of the largest to the smallest value from which on an axis is better logarithmic."""

DASHES = (3.6, 2.7)
"""Lengths of dashes and gaps of limits."""

REPEATED = (5.0, 3.0)
"""Those of curves that repeat a colour."""


@dataclass(frozen=True)
class Curve:
    """A line through points x (N,), y (N,), broken where a value isn't finite.

    Attributes:
        x, y: the points.
        label: text in the legend; without it the curve isn't there.
        colour, width, opacity: of the line; width 0 for none.
        dot: sign at each point.
        is_read: whether pointing at the curve shows its values.
        more: name with unit → further values (N,) that are shown instead of x and y.
        notes: text for each point that is shown as well.
        dashes: lengths of dashes and gaps; none for a line without gaps.
        fill: opacity of the area within a closed line; 0 for none.
        group: name for the page's script.
        source: what a page that simulates computes the curve from: ``of`` and ``factor`` for a signal or what ``Result.curve`` in
            simulation.js has, ``run`` for its place among the runs, or ``metric`` and ``key`` for a metric over a slider's value.
    """

    x: RealArray
    y: RealArray
    label: str = ""
    colour: str = FIRST
    width: float = 1.4
    opacity: float = 1.0
    dot: Literal["", "disc", "cross"] = ""
    is_read: bool = True
    more: Mapping[str, RealArray] = field(default_factory=dict)
    notes: Sequence[str] = ()
    dashes: tuple[float, ...] = ()
    fill: float = 0.0
    group: str = ""
    source: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Marker:
    """A disc or a square of a size, and a text at an offset from its middle; without a size only the text."""

    x: float
    y: float
    size: float = 0.0
    colour: str = INK
    opacity: float = 1.0
    shape: Literal["disc", "square"] = "disc"
    text: str = ""
    offset: tuple[float, float] = (0.0, 0.0)
    anchor: Literal["start", "middle", "end"] = "start"
    group: str = ""


@dataclass(frozen=True)
class Panel:
    """What a pair of axes shows.

    Attributes:
        label: of the vertical axis; may have two lines.
        curves, markers: what is drawn, in this order.
        limits: of the horizontal axis; None for those of the curves.
        least: where the vertical axis starts; None for the smallest value of the curves.
        level: where a dashed horizontal line is drawn.
        marks: where dashed vertical lines are drawn, and the texts above them.
        is_to_scale: whether both axes have the same scale.
        logarithmic: which axes are logarithmic: "", "x", "y" or "xy".
        is_function: whether x increases along each curve: values are then read at one x for all curves, otherwise at one point.
        motion: what the page's script animates; None for nothing.
    """

    label: str
    curves: Sequence[Curve]
    markers: Sequence[Marker] = ()
    limits: tuple[float, float] | None = None
    least: float | None = None
    level: float | None = None
    marks: Sequence[tuple[float, str]] = ()
    is_to_scale: bool = False
    logarithmic: str = ""
    is_function: bool = True
    motion: Mapping[str, Any] | None = None

    def thinned(self, most: int) -> Panel:
        """The panel with curves of at most so many points."""
        curves = list[Curve]()
        for each in self.curves:
            chosen = thinned(each.y, most) if self.is_function else spread(each.y.size, most)
            more = {name: values[chosen] for name, values in each.more.items()}
            notes = [each.notes[i] for i in chosen] if each.notes else ()
            curves.append(replace(each, x=each.x[chosen], y=each.y[chosen], more=more, notes=notes))
        return replace(self, curves=curves)

    def plain(self, x_label: str) -> str:
        """A picture without axes for pages without scripts, and its limits as text; nothing where nothing is drawn."""
        curves = [each for each in self.thinned(PLAIN_POINTS).curves if each.width or each.dot]
        points, logs = [np.array([each.x, each.y]) for each in curves], [[axis in self.logarithmic] for axis in "xy"]
        points = [np.where(logs & ~(each > 0.0), np.nan, each) for each in points]
        finite = np.concatenate(
            [each[:, np.isfinite(each).all(axis=0)] for each in points] or [np.zeros((2, 0))], axis=1
        )
        if not finite.size:
            return ""
        ends = finite.min(axis=1, keepdims=True), finite.max(axis=1, keepdims=True)
        said = f"{x_label}: {ends[0][0, 0]:.4g} to {ends[1][0, 0]:.4g}; {self.label}: {ends[0][1, 0]:.4g} to {ends[1][1, 0]:.4g}"
        # in units of the axes: the browser scales
        low, high, *points = (np.where(logs, np.log10(np.where(logs, each, 1.0)), each) for each in (*ends, *points))
        size = np.where(high > low, high - low, np.where(low != 0.0, np.abs(low), 1.0))
        scale = [[300.0], [-300.0 if self.is_to_scale else -120.0]] / (size[0] if self.is_to_scale else size)
        lines = "".join(
            f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in placed.T[np.isfinite(placed).all(axis=0)].tolist())}" '
            f'style="stroke:{curve.colour};opacity:{curve.opacity:g}"/>'
            for curve, values in zip(curves, points, strict=True)
            for placed in [scale * (values - low)]
        )
        names = {each.label: each.colour for each in curves if each.label}
        key = "".join(f', <b style="color:{colour}">{escape(name)}</b>' for name, colour in names.items())
        shape = "" if self.is_to_scale else ' preserveAspectRatio="none"'
        height = float(-scale[1] @ size[1])
        box = f'viewBox="0 {-height:.0f} 300 {height:.0f}"{shape}'
        return f'<svg class="plain" {box} role="img" aria-label="{escape(said)}">{lines}</svg><p class="caption">{escape(said)}{key}</p>'


def look(number: int) -> dict[str, Any]:
    """Return colour and dashes of one of many curves."""
    return {"colour": PALETTE[number % len(PALETTE)], "dashes": REPEATED if number >= len(PALETTE) else ()}


def scale_of(values: ArrayLike) -> Literal["", "y"]:
    """Return which axis `Panel.logarithmic` is for values of a vertical axis, which may be NaN: of positive ones far apart."""
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    return "y" if known.size and known.max() > MANY * known.min() > 0.0 else ""


def thinned(y: RealArray, most: int = MOST_POINTS) -> NDArray[np.intp]:
    """Return the indices of at most ``most`` of the values (N,), four at least: all, or the smallest and largest of equal pieces.

    First and last value are among them, and so are the smallest and largest of all.
    """
    if y.size <= most:
        return np.arange(y.size)
    # NaN breaks a curve; it is neither smallest nor largest
    size = -(-y.size // (most // 2 - 1))
    padded = np.append(y, np.full(-y.size % size, np.nan)).reshape(-1, size)
    starts = size * np.arange(len(padded))
    least = np.where(np.isfinite(padded), padded, np.inf).argmin(axis=1)
    most = np.where(np.isfinite(padded), padded, -np.inf).argmax(axis=1)
    found = np.concatenate([[0], starts + least, starts + most, [y.size - 1]])
    found = np.sort(found[found < y.size])
    return np.asarray(found[np.diff(found, prepend=-1) > 0])  # `np.unique` would load numpy.ma


def spread(count: int, most: int = MOST_POINTS) -> NDArray[np.intp]:
    """Return at most ``most`` equally spaced indices of ``count`` values, first and last included."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.intp)
