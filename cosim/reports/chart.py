"""Line charts as SVG elements of a page, in its colours and font. Matplotlib would take longer to load than a scene takes to run.

The layout follows matplotlib's: ticks at multiples of 1, 2, 2.5, 5 and 10 times a power of ten, at most nine of them, limits 1 %
and 5 % beyond the curves. Lengths are points, y downwards.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from typing import Literal

import numpy as np

from flexfmu.cosim.engine.slave import RealArray

INK, GREY, PALE = "var(--ink)", "var(--grey)", "var(--line)"
FIRST, SECOND = "var(--first)", "var(--second)"
"""Colours: variables that the page defines (``templates/report.html.j2``)."""

FONT, SMALL, SMALLEST = 9.0, 8.5, 8.0
"""Font sizes of axes; of legends and notes; of marks."""

PADDING, BELOW, GAP, ROW = 3.0, 32.0, 9.5, 12.6
"""Distance from the chart's edge; space below the panels for ticks and label; between panels; of lines of text."""

LEGEND, MARK, NOTES = 21.3, 9.1, 4.9
"""Space above a panel for a legend, for a mark's text, and for texts of markers at its top."""

MOST_TICKS, STEPS = 9, (1.0, 2.0, 2.5, 5.0, 10.0)
"""Largest number of intervals between ticks, and their lengths."""

CHARACTERS, DIGIT, LETTER = {".": 0.32, "−": 0.84}, 0.64, 0.45
"""Widths of characters of a number, of digits, and of letters on average, relative to the font size."""

RESOLUTION = 0.1
"""To which points of curves are rounded."""


@dataclass(frozen=True)
class Curve:
    """A line through points x (N,), y (N,), broken where a value isn't finite; with a label it is in the legend."""

    x: RealArray
    y: RealArray
    label: str = ""
    colour: str = FIRST
    width: float = 1.4
    opacity: float = 1.0


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
    anchor: Literal["start", "middle"] = "start"


@dataclass(frozen=True, kw_only=True)
class Panel:
    """What a pair of axes shows.

    Attributes:
        label: of the vertical axis; may have two lines.
        curves, markers: what is drawn, in this order.
        from_zero: whether the vertical axis starts at zero.
        limits: of the horizontal axis; None for those of the curves.
        level: where a dashed horizontal line is drawn.
        mark: where a dashed vertical line is drawn, and the text above it.
        is_to_scale: whether both axes have the same scale.
    """

    label: str
    curves: Sequence[Curve]
    markers: Sequence[Marker] = ()
    from_zero: bool = False
    limits: tuple[float, float] | None = None
    level: float | None = None
    mark: tuple[float, str] | None = None
    is_to_scale: bool = False


def draw_chart(key: str, title: str, size: tuple[float, float], x_label: str, panels: Sequence[Panel]) -> str:
    """Return a chart of panels below each other, with a common horizontal axis, as an SVG element.

    Args:
        key: unique identifier within the page.
        title: text for screen readers.
        size: width and height.
        x_label: label of the horizontal axis.
        panels: at least one; the legend is that of the first.
    """
    (width, height), boxes = size, list(_boxes(size, panels))
    parts = [f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(title)}">']
    for number, (panel, box) in enumerate(zip(panels, boxes, strict=True)):
        parts += box.drawn(panel, f"{key}-{number}", x_label if number == len(panels) - 1 else None)
    return "\n".join([*parts, *_legend(panels[0], width), "</svg>"])


@dataclass(frozen=True)
class _Axis:
    """An axis from the value ``low`` at the position ``begin`` to ``high`` at ``end``; ``room`` is the length that an interval needs."""

    low: float
    high: float
    begin: float
    end: float
    room: float

    def at(self, value: RealArray | float) -> RealArray:
        """Return the positions of values."""
        scale = (self.end - self.begin) / (self.high - self.low)
        return np.asarray(self.begin + (np.asarray(value, dtype=float) - self.low) * scale)

    @cached_property
    def ticks(self) -> RealArray:
        """Values of the ticks: multiples of the shortest step that leaves enough room, at least two."""
        span = self.high - self.low
        raw = span / min(max(int(abs(self.end - self.begin) / self.room), 1), MOST_TICKS)
        power = 10.0 ** math.floor(math.log10(raw))
        fitting = [step * power for step in STEPS if step * power >= raw * (1.0 - 1e-9)]
        shorter = [step * power for step in reversed(STEPS) if step * power < raw]
        for step in (fitting[0], *shorter, STEPS[-2] * 0.1 * power):
            first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
            if last > first:
                break
        return np.asarray(step * np.arange(first, last + 1), dtype=np.float64)

    @cached_property
    def labels(self) -> list[str]:
        """Texts of the ticks, with as many decimals as tell them apart; powers of ten where there would be many zeros."""
        ticks, largest = self.ticks, float(np.max(np.abs(self.ticks)))
        if not 1e-4 <= largest < 1e6:
            return [f"{tick:.6g}".replace("-", "−") for tick in ticks.tolist()]
        exact = 1e-3 * float(ticks[1] - ticks[0])
        decimals = next((d for d in range(12) if np.all(np.abs(ticks - np.round(ticks, d)) < exact)), 12)
        return [f"{tick + 0.0:.{decimals}f}".replace("-", "−") for tick in ticks.tolist()]


@dataclass(frozen=True)
class _Box:
    """The axes of a panel."""

    x: _Axis
    y: _Axis

    def drawn(self, panel: Panel, key: str, x_label: str | None) -> Iterator[str]:
        """Yield the elements of a panel, grid first; ticks of the horizontal axis have labels if the axis has one."""
        left, right, top, bottom = self.x.begin, self.x.end, self.y.end, self.y.begin
        yield (
            f'<clipPath id="{key}"><rect x="{left:.2f}" y="{top:.2f}" width="{right - left:.2f}" '
            f'height="{bottom - top:.2f}"/></clipPath>'
        )
        verticals = "".join(f"M{x:.2f} {bottom:.2f}V{top:.2f}" for x in self.x.at(self.x.ticks))
        horizontals = "".join(f"M{left:.2f} {y:.2f}H{right:.2f}" for y in self.y.at(self.y.ticks))
        yield _line(verticals + horizontals, PALE, 0.8)
        # curves and markers within the box
        yield f'<g clip-path="url(#{key})">'
        yield from (
            _line(_path(self.x.at(each.x), self.y.at(each.y)), each.colour, each.width, each.opacity, cap="round")
            for each in panel.curves
        )
        yield "</g>"
        for each in panel.markers:
            yield from _marker(each, float(self.x.at(each.x)), float(self.y.at(each.y)))
        yield from self._marks(panel)
        # axes with ticks
        ticks = "".join(f"M{x:.2f} {bottom:.2f}v3.5" for x in self.x.at(self.x.ticks))
        ticks += "".join(f"M{left:.2f} {y:.2f}h-3.5" for y in self.y.at(self.y.ticks))
        yield _line(f"M{left:.2f} {top:.2f}V{bottom:.2f}H{right:.2f}{ticks}", GREY, 0.8)
        yield from self._texts(panel, x_label)

    def _marks(self, panel: Panel) -> Iterator[str]:
        """Yield the dashed lines within the box, and the text above."""
        if panel.level is not None and self.y.low < panel.level < self.y.high:
            line = f"M{self.x.begin:.2f} {self.y.at(panel.level):.2f}H{self.x.end:.2f}"
            yield _line(line, GREY, 0.9, dashes="3.6,2.7")
        if panel.mark is not None:
            time, text = panel.mark
            x, top = float(self.x.at(time)), self.y.end
            yield _line(f"M{x:.2f} {self.y.begin:.2f}V{top:.2f}", GREY, 0.9, dashes="3.6,2.7")
            yield _text(text, x, top - PADDING, SMALLEST, "middle", GREY)

    def _texts(self, panel: Panel, x_label: str | None) -> Iterator[str]:
        """Yield the labels of ticks and axes."""
        left, bottom = self.x.begin, self.y.begin
        for y, text in zip(self.y.at(self.y.ticks), self.y.labels, strict=True):
            yield _text(text, left - 7.0, y + 3.42, FONT, "end")
        if x_label is not None:
            for x, text in zip(self.x.at(self.x.ticks), self.x.labels, strict=True):
                yield _text(text, x, bottom + 13.84, FONT, "middle")
            yield _text(x_label, 0.5 * (left + self.x.end), bottom + 26.84, FONT, "middle")
        for row, text in enumerate(panel.label.split("\n")):
            yield _text(text, 9.84 + ROW * row, 0.5 * (bottom + self.y.end), FONT, "middle", upright=False)


def _boxes(size: tuple[float, float], panels: Sequence[Panel]) -> Iterator[_Box]:
    """Yield the axes of each panel, all of the same height and the same horizontal limits."""
    (width, height), count = size, len(panels)
    above = [MARK * (panel.mark is not None) for panel in panels]
    above[0] += NOTES * panels[0].is_to_scale + LEGEND * any(curve.label for curve in panels[0].curves)
    each = (height - BELOW - PADDING - sum(above) - GAP * (count - 1)) / count
    # horizontal limits, and vertical axes with their places
    low, high = panels[0].limits or _limits(
        [curve.x for panel in panels for curve in panel.curves], 0.05 if panels[0].is_to_scale else 0.01
    )
    verticals, top = [], PADDING
    for panel, space in zip(panels, above, strict=True):
        top += space
        bottom, top_limit = _limits([curve.y for curve in panel.curves], 0.05)
        verticals.append(_Axis(0.0 if panel.from_zero else bottom, top_limit, top + each, top, 2.0 * FONT))
        top += each + GAP
    # the widest number leaves the rest to the panels
    digits = max(sum(CHARACTERS.get(c, DIGIT) for c in text) for axis in verticals for text in axis.labels)
    rows = max(panel.label.count("\n") for panel in panels)
    begin, end = 2 * 8.0 + ROW * rows + FONT * digits + 7.0, width - PADDING
    for panel, axis in zip(panels, verticals, strict=True):
        horizontal = _Axis(low, high, begin, end, 3.0 * FONT)
        yield _to_scale(horizontal, axis) if panel.is_to_scale else _Box(horizontal, axis)


def _to_scale(x: _Axis, y: _Axis) -> _Box:
    """Return axes of the same scale, as large as these ones allow, in the middle of their top."""
    across, down = x.high - x.low, y.high - y.low
    scale = min((x.end - x.begin) / across, (y.begin - y.end) / down)
    spare = 0.5 * (x.end - x.begin - scale * across)
    return _Box(replace(x, begin=x.begin + spare, end=x.end - spare), replace(y, begin=y.end + scale * down))


def _limits(values: Sequence[RealArray], margin: float) -> tuple[float, float]:
    """Return the smallest and the largest finite value, with a margin in terms of their difference."""
    finite = np.concatenate([np.zeros(0), *(each[np.isfinite(each)] for each in values)])
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        span = 0.1 * max(abs(low), abs(high)) or 0.1  # of a constant
        low, high = low - 0.5 * span, high + 0.5 * span
    return low - margin * (high - low), high + margin * (high - low)


def _path(x: RealArray, y: RealArray) -> str:
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


def _line(path: str, colour: str, width: float, opacity: float = 1.0, *, cap: str = "butt", dashes: str = "") -> str:
    """Return a path without filling."""
    style = f'stroke="{colour}" stroke-width="{width:g}" stroke-linecap="{cap}" stroke-linejoin="round"'
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
    faint = f' stroke-opacity="{opacity:g}"' if opacity < 1.0 else ""
    return f'<path d="{path}" fill="none" {style}{dashed}{faint}/>'


def _text(text: str, x: float, y: float, size: float, anchor: str, colour: str = INK, *, upright: bool = True) -> str:
    """Return a text with its baseline's start, middle or end at a point."""
    turned = "" if upright else f' transform="rotate(-90 {x:.2f} {y:.2f})"'
    place = f'x="{x:.2f}" y="{y:.2f}" font-size="{size:g}" text-anchor="{anchor}" fill="{colour}"{turned}'
    return f"<text {place}>{escape(text)}</text>"


def _marker(marker: Marker, x: float, y: float) -> Iterator[str]:
    """Yield the disc or square, and the text beside it."""
    half, style = 0.5 * marker.size, f'fill="{marker.colour}" fill-opacity="{marker.opacity:g}"'
    if marker.size and marker.shape == "disc":
        yield f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{half:g}" {style}/>'
    elif marker.size:
        yield f'<rect x="{x - half:.2f}" y="{y - half:.2f}" width="{marker.size:g}" height="{marker.size:g}" {style}/>'
    if marker.text:
        yield _text(marker.text, x + marker.offset[0], y + marker.offset[1], SMALL, marker.anchor)


def _legend(panel: Panel, width: float) -> list[str]:
    """Return lines and texts of the curves with a label, side by side in the upper right corner."""
    parts, x = [], width - PADDING - 4.6
    for curve in reversed([curve for curve in panel.curves if curve.label]):
        x -= LETTER * SMALL * len(curve.label)
        parts.append(_text(curve.label, x, 14.11, SMALL, "start"))
        parts.append(_line(f"M{x - 23.8:.2f} 11.13h17", curve.colour, curve.width))
        x -= 40.8
    return parts
