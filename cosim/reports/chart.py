"""Charts of a page: what they show as data for uPlot, which draws them (`templates/page.js`), and a plain picture for pages without scripts.

Matplotlib would take longer to load than a scene takes to run. Curves travel as 32-bit numbers, see `packed`.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
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
"""Largest number of points of a curve that a page has."""

PLAIN_POINTS = 160
"""Largest number of points of a curve in a picture without scripts, about."""

PIXELS, LEAST_HEIGHT = 1.25, 110
"""Pixels of a point, and least height of a panel [px]."""

MANY = 20.0
"""Ratio of the largest to the smallest value from which on an axis is better logarithmic."""

DASHES = "3.6,2.7"


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
        dashes: lengths of dashes and gaps, separated by commas.
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
    dashes: str = ""
    fill: float = 0.0
    group: str = ""
    source: Mapping[str, Any] | None = None

    def data(self, is_function: bool, most: int) -> dict[str, Any]:
        """The curve for the script; of a long one at most so many points."""
        chosen = thinned(self.y, most) if is_function else spread(self.y.size, most)
        known = {
            name: getattr(self, name)
            for name in ("label", "colour", "width", "opacity", "dot", "is_read", "fill", "group", "source")
        }
        channels = (self.x, self.y, *self.more.values())
        known |= {"dashes": [float(each) for each in self.dashes.split(",") if each]}
        known |= {"xy": packed(*(each[chosen] for each in channels)), "more": [*self.more]}
        return known | ({"notes": [self.notes[i] for i in chosen]} if self.notes else {})


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
        from_zero: whether the vertical axis starts at zero.
        limits: of the horizontal axis; None for those of the curves.
        least: smallest value of the vertical axis; None for that of the curves.
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
    from_zero: bool = False
    limits: tuple[float, float] | None = None
    least: float | None = None
    level: float | None = None
    marks: Sequence[tuple[float, str]] = ()
    is_to_scale: bool = False
    logarithmic: str = ""
    is_function: bool = True
    motion: Mapping[str, Any] | None = None

    def data(self, height: float, most: int) -> dict[str, Any]:
        """The panel for the script, its height in pixels."""
        names = ("label", "from_zero", "least", "level", "marks", "is_to_scale", "logarithmic", "is_function", "motion")
        found = {name: getattr(self, name) for name in names}
        found |= {"xLimits": self.limits, "height": round(height), "markers": [asdict(each) for each in self.markers]}
        return found | {"curves": [each.data(self.is_function, most) for each in self.curves]}


def draw_chart(
    key: str, title: str, size: tuple[float, float], x_label: str, panels: Sequence[Panel], most: int = MOST_POINTS
) -> str:
    """Return a chart of panels below each other, with a common horizontal axis, as HTML.

    Args:
        key: unique identifier within the page.
        title: text for screen readers.
        size: width and height [pt].
        x_label: label of the horizontal axis.
        panels: at least one.
        most: largest number of points of a curve.
    """
    height = max(LEAST_HEIGHT, PIXELS * size[1] / len(panels))
    data = {"key": key, "x": x_label, "panels": [each.data(height, most) for each in panels]}
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), default=float).replace("<", "\\u003c")
    plain = "".join(_plain(each, x_label) for each in panels)
    return (
        f'<div class="chart" role="group" aria-label="{escape(title)}"><script type="application/json">{text}</script>'
        f"<noscript>{plain}</noscript></div>"
    )


def _plain(panel: Panel, x_label: str) -> str:
    """Return a picture of a panel without axes, and its limits as text."""
    curves = [each for each in panel.curves if each.width or each.dot]
    points = []
    for each in curves:
        chosen = thinned(each.y, PLAIN_POINTS) if panel.is_function else spread(each.y.size, PLAIN_POINTS)
        points.append(np.array([each.x[chosen], each.y[chosen]], dtype=float))
    for axis in (axis for axis, name in enumerate("xy") if name in panel.logarithmic):
        for values in points:
            values[axis] = np.log10(np.where(values[axis] > 0.0, values[axis], np.nan))
    # in units of the axes: the browser scales
    joined = np.concatenate([*points, np.zeros((2, 0))], axis=1)
    finite = joined[:, np.isfinite(joined).all(axis=0)]
    low, high = (finite.min(axis=1), finite.max(axis=1)) if finite.size else (np.zeros(2), np.ones(2))
    size = np.where(high > low, high - low, np.where(low != 0.0, np.abs(low), 1.0))
    ends = [
        10.0**v if name in panel.logarithmic else v
        for name, v in zip("xxyy", np.stack([low, high]).T.ravel(), strict=True)
    ]
    said = f"{x_label}: {ends[0]:.4g} to {ends[1]:.4g}; {panel.label}: {ends[2]:.4g} to {ends[3]:.4g}"
    names = {each.label: each.colour for each in curves if each.label}
    key = "".join(f', <b style="color:{colour}">{escape(name)}</b>' for name, colour in names.items())
    scale = np.array([300.0, 300.0 if panel.is_to_scale else 120.0]) / (size[0] if panel.is_to_scale else size)
    lines = "".join(
        f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in scaled[np.isfinite(scaled).all(axis=1)].tolist())}" '
        f'style="stroke:{curve.colour};opacity:{curve.opacity:g}"/>'
        for curve, values in zip(curves, points, strict=True)
        for scaled in [(values - [[low[0]], [high[1]]]).T * scale * [1.0, -1.0]]
    )
    shape = "" if panel.is_to_scale else ' preserveAspectRatio="none"'
    box = f'viewBox="0 0 300 {scale[1] * size[1]:.0f}"{shape}'
    return f'<svg class="plain" {box} role="img" aria-label="{escape(said)}">{lines}</svg><p class="caption">{escape(said)}{key}</p>'


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


def packed(*channels: RealArray) -> str:
    """Return arrays one after the other as base64 of little-endian 32-bit numbers, 24 significant bits each: for zooming and reading."""
    return base64.b64encode(np.concatenate([np.ravel(each) for each in channels]).astype("<f4").tobytes()).decode()


def unpacked(text: str, channels: int) -> RealArray:
    """Return the arrays (channels, N) of `packed`."""
    return np.frombuffer(base64.b64decode(text), dtype="<f4").astype(np.float64).reshape(channels, -1)
