"""Line charts as SVG elements of a page, in its colours and font. Matplotlib would take longer to load than a scene takes to run.

The layout follows matplotlib's: limits 1 % and 5 % beyond the curves. Lengths are points, y downwards. A chart is complete without
scripts; with them it zooms and shows values (`templates/page.js`): each panel has its axes in ``data-axes``, each curve its values
in ``data-xy`` (see `packed`), and what moves with the axes is a group with ``data-at``.

Axes of charts: positions, ticks and their labels, as matplotlib has them: ticks at multiples of 1, 2, 2.5, 5 and 10 times a
power of ten, at most nine intervals. `templates/page.js` has the same rules for charts that are zoomed.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.slave import RealArray

INK, GREY, PALE = "var(--ink)", "var(--grey)", "var(--line)"
FIRST, SECOND = "var(--first)", "var(--second)"
PALETTE = (FIRST, SECOND, *(f"var(--{name})" for name in ("third", "fourth", "fifth", "sixth", "seventh", "eighth")))
"""Colours: variables that the page defines (``templates/page.css``)."""

RESOLUTION = 0.1
"""To which points of curves are rounded."""

MOST_POINTS = 2000
"""Largest number of points of a curve that a page has."""

MOST_TICKS, STEPS = 9, (1.0, 2.0, 2.5, 5.0, 10.0)
"""Largest number of intervals between ticks, and their lengths."""


@dataclass(frozen=True)
class Axis:
    """An axis from the value ``low`` at the position ``begin`` to ``high`` at ``end``.

    Attributes:
        room: length that an interval between ticks needs.
        is_log: whether the axis is logarithmic.
    """

    low: float
    high: float
    begin: float
    end: float
    room: float
    is_log: bool = False

    def at(self, value: RealArray | float) -> RealArray:
        """Return the positions of values; those that a logarithmic axis doesn't have are NaN."""
        values, low, high = np.asarray(value, dtype=float), self.low, self.high
        if self.is_log:
            values = np.log10(np.where(values > 0.0, values, np.nan))
            low, high = math.log10(low), math.log10(high)
        return np.asarray(self.begin + (values - low) * ((self.end - self.begin) / (high - low)))

    @property
    def _intervals(self) -> int:
        """Number of intervals for which there is room."""
        return min(max(int(abs(self.end - self.begin) / self.room), 1), MOST_TICKS)

    @cached_property
    def ticks(self) -> RealArray:
        """Values of the ticks: multiples of the shortest step that leaves enough room, at least two; powers of ten on a log axis."""
        if self.is_log:
            return self._decades()
        span = self.high - self.low
        raw = span / self._intervals
        power = 10.0 ** math.floor(math.log10(raw))
        fitting = [step * power for step in STEPS if step * power >= raw * (1.0 - 1e-9)]
        shorter = [step * power for step in reversed(STEPS) if step * power < raw]
        for step in (fitting[0], *shorter, STEPS[-2] * 0.1 * power):
            first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
            if last > first:
                break
        return np.asarray(step * np.arange(first, last + 1), dtype=np.float64)

    def _decades(self) -> RealArray:
        """Return powers of ten, every so many that there is room; with 2 and 5 times them where there are fewer than three."""
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        every = max(1, math.ceil((last - first) / self._intervals))
        for factors in ((1.0,), (1.0, 2.0, 5.0), tuple(range(1, 10))):
            exponents = [k for k in range(first, last + 1) if k % every == 0]
            found = np.array([float(f"{factor:g}e{k}") for k in exponents for factor in factors])
            found = found[(found >= self.low * (1.0 - 1e-9)) & (found <= self.high * (1.0 + 1e-9))]
            if found.size > 2:
                break
        return found if found.size > 1 else np.array([self.low, self.high])

    @cached_property
    def labels(self) -> list[str]:
        """Texts of the ticks, with as many decimals as tell them apart; powers of ten where there would be many zeros."""
        ticks, largest = self.ticks, float(np.max(np.abs(self.ticks)))
        if self.is_log or not 1e-4 <= largest < 1e6:
            return [f"{tick:.6g}".replace("-", "−") for tick in ticks.tolist()]
        exact = 1e-3 * float(ticks[1] - ticks[0])
        decimals = next((d for d in range(12) if np.all(np.abs(ticks - np.round(ticks, d)) < exact)), 12)
        return [f"{tick + 0.0:.{decimals}f}".replace("-", "−") for tick in ticks.tolist()]


def limits(values: Sequence[RealArray], margin: float, is_log: bool = False) -> tuple[float, float]:
    """Return the smallest and the largest finite value, with a margin in terms of their difference; positive ones on a log axis."""
    finite = np.concatenate([np.zeros(0), *(each[np.isfinite(each)] for each in values)])
    if is_log:
        logarithms = np.log10(finite[finite > 0.0])
        low, high = limits([logarithms if logarithms.size else np.array([-1.0, 0.0])], margin)
        return 10.0**low, 10.0**high
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        span = 0.1 * max(abs(low), abs(high)) or 0.1  # of a constant
        low, high = low - 0.5 * span, high + 0.5 * span
    return low - margin * (high - low), high + margin * (high - low)


FONT, SMALL, SMALLEST, ON_PHONES = 9.0, 8.5, 8.0, 10.5
"""Font sizes of axes; of legends and notes; of marks; of all on narrow screens (``templates/page.css``)."""

PADDING, BELOW, GAP, ROW = 3.0, 32.0, 9.5, 12.6
"""Distance from the chart's edge; space below the panels for ticks and label; between panels; of lines of text."""

LEGEND, MARK, NOTES = 21.3, 9.1, 4.9
"""Space above a panel for a legend of one row, for a mark's text, and for texts of markers at its top."""

CHARACTERS, DIGIT, LETTER = {".": 0.32, "−": 0.84}, 0.64, 0.53
"""Widths of characters of a number, of digits, and of letters on average, relative to the font size."""

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
        dashes: of the line, as SVG has them.
        group: class of the element, for the page's script.
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
    group: str = ""


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
    group: str = ""


@dataclass(frozen=True, kw_only=True)
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
        data: name → text, attributes ``data-name`` for the page's script.
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
    data: Mapping[str, str] = field(default_factory=dict)


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
    name = escape(title)
    parts = [f'<svg class="chart" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{name}">']
    for number, (panel, box) in enumerate(zip(panels, boxes, strict=True)):
        parts += box.drawn(panel, f"{key}-{number}", x_label, is_last=number == len(panels) - 1)
    # legend: lines and texts of the curves with a label, side by side at the right
    for row, curves in enumerate(_rows(panels[0], width)):
        x, y = width - PADDING - 4.6, ROW * row
        for curve in reversed(curves):
            x -= LETTER * ON_PHONES * len(curve.label)
            line = stroke(f"M{x - 23.8:.2f} {11.13 + y:.2f}h17", curve.colour, curve.width or 1.4, dashes=curve.dashes)
            text = text_at(curve.label, x, 14.11 + y, SMALL, "start")
            parts.append(f'<g class="key" data-label="{escape(curve.label)}">{text}{line}</g>')
            x -= 40.8
    return "\n".join([*parts, "</svg>"])


@dataclass(frozen=True)
class _Box:
    """The axes of a panel."""

    x: Axis
    y: Axis

    def drawn(self, panel: Panel, key: str, x_label: str, is_last: bool) -> Iterator[str]:
        """Yield the elements of a panel, grid first; ticks of the horizontal axis have labels in the last panel."""
        left, right, top, bottom = self.x.begin, self.x.end, self.y.end, self.y.begin
        yield self._opened(panel, x_label, is_last)
        yield (
            f'<clipPath id="{key}"><rect x="{left:.2f}" y="{top:.2f}" width="{right - left:.2f}" '
            f'height="{bottom - top:.2f}"/></clipPath>'
        )
        verticals = "".join(f"M{x:.2f} {bottom:.2f}V{top:.2f}" for x in self.x.at(self.x.ticks))
        horizontals = "".join(f"M{left:.2f} {y:.2f}H{right:.2f}" for y in self.y.at(self.y.ticks))
        yield stroke(verticals + horizontals, PALE, 0.8, extra=' class="grid"')
        # curves and markers within the box
        yield f'<g clip-path="url(#{key})">'
        for each in panel.curves:
            yield from self._curve(each, panel)
        yield "</g>"
        for marker in panel.markers:
            yield self._at(marker.x, marker.y, _marker(marker), marker.group)
        yield from self._marks(panel)
        # axes with ticks
        ticks = "".join(f"M{x:.2f} {bottom:.2f}v3.5" for x in self.x.at(self.x.ticks))
        ticks += "".join(f"M{left:.2f} {y:.2f}h-3.5" for y in self.y.at(self.y.ticks))
        yield stroke(f"M{left:.2f} {top:.2f}V{bottom:.2f}H{right:.2f}{ticks}", GREY, 0.8, extra=' class="frame"')
        yield from self._texts(panel, x_label if is_last else None)
        yield "</g>"

    def _opened(self, panel: Panel, x_label: str, is_last: bool) -> str:
        """Return the start tag of the panel's group, with all that a script needs to draw it anew."""
        numbers = (
            *(self.x.low, self.x.high, self.x.begin, self.x.end, self.x.is_log),
            *(self.y.low, self.y.high, self.y.begin, self.y.end, self.y.is_log),
        )
        flags = {"function": panel.is_function, "scale": panel.is_to_scale, "zero": panel.from_zero, "last": is_last}
        data = {
            "axes": " ".join(f"{number:.9g}" for number in numbers),
            "names": json.dumps([x_label, panel.label.replace("\n", " ")], ensure_ascii=False),
            "flags": " ".join(name for name, is_set in flags.items() if is_set),
            **panel.data,
        }
        return f'<g class="panel"{attributes(data)}>'

    def _curve(self, curve: Curve, panel: Panel) -> Iterator[str]:
        """Yield the line and the signs of a curve, with its values; of a long curve as many points as a page has."""
        chosen = thinned(curve.y) if panel.is_function else spread(curve.y.size)
        given_x, given_y = curve.x[chosen], curve.y[chosen]
        data = {"xy": packed(given_x, given_y, *(each[chosen] for each in curve.more.values()))}
        data |= {"label": curve.label} if curve.label else {}
        data |= {"more": json.dumps(list(curve.more), ensure_ascii=False)} if curve.more else {}
        data |= {"notes": json.dumps([curve.notes[i] for i in chosen], ensure_ascii=False)} if curve.notes else {}
        # line, then signs
        x, y, colour = self.x.at(given_x), self.y.at(given_y), curve.colour
        kind = f"{'curve' if curve.is_read else 'shape'} {curve.group}".strip()
        extra, path = f' class="{kind}"{attributes(data)}', line_path(x, y) if curve.width else ""
        yield stroke(path, colour, curve.width, curve.opacity, cap="round", dashes=curve.dashes, extra=extra)
        if curve.dot:
            width, extra = 1.4 if curve.dot == "cross" else 4.5, f' class="{curve.dot}"'
            yield stroke(signs(x, y, curve.dot), colour, width, cap="round", extra=extra)

    def _at(self, x: float | None, y: float | None, content: str, group: str = "") -> str:
        """Return elements about a point that moves with the axes, or about an axis where a coordinate is None."""
        place = float(self.x.at(x)) if x is not None else 0.0, float(self.y.at(y)) if y is not None else 0.0
        coordinates = " ".join("*" if each is None else f"{each:.9g}" for each in (x, y))
        kind = f"at {group}".strip()
        return f'<g class="{kind}" data-at="{coordinates}" transform="translate({place[0]:.2f} {place[1]:.2f})">{content}</g>'

    def _marks(self, panel: Panel) -> Iterator[str]:
        """Yield the dashed lines within the box, and the texts above."""
        if panel.level is not None and self.y.low < panel.level < self.y.high:
            line = stroke(f"M{self.x.begin:.2f} 0H{self.x.end:.2f}", GREY, 0.9, dashes=DASHES)
            yield self._at(None, panel.level, line)
        for place, text in panel.marks:
            line = stroke(f"M0 {self.y.begin:.2f}V{self.y.end:.2f}", GREY, 0.9, dashes=DASHES)
            yield self._at(place, None, line + text_at(text, 0.0, self.y.end - PADDING, SMALLEST, "middle", GREY))

    def _texts(self, panel: Panel, x_label: str | None) -> Iterator[str]:
        """Yield the labels of ticks and axes."""
        left, bottom = self.x.begin, self.y.begin
        yield '<g class="ticks">'
        for y, text in zip(self.y.at(self.y.ticks), self.y.labels, strict=True):
            yield text_at(text, left - 7.0, y + 3.42, FONT, "end")
        if x_label is not None:
            for x, text in zip(self.x.at(self.x.ticks), self.x.labels, strict=True):
                yield text_at(text, x, bottom + 13.84, FONT, "middle")
        yield "</g>"
        if x_label is not None:
            yield text_at(x_label, 0.5 * (left + self.x.end), bottom + 26.84, FONT, "middle")
        for row, text in enumerate(panel.label.split("\n")):
            yield text_at(text, 9.84 + ROW * row, 0.5 * (bottom + self.y.end), FONT, "middle", upright=False)


def _boxes(size: tuple[float, float], panels: Sequence[Panel]) -> Iterator[_Box]:
    """Yield the axes of each panel, all of the same height and the same horizontal limits."""
    (width, height), count = size, len(panels)
    above = [MARK * bool(panel.marks) for panel in panels]
    rows = len(_rows(panels[0], width))
    above[0] += NOTES * panels[0].is_to_scale + (LEGEND + ROW * (rows - 1) if rows else 0.0)
    each = (height - BELOW - PADDING - sum(above) - GAP * (count - 1)) / count
    # horizontal limits, and vertical axes with their places
    is_log = "x" in panels[0].logarithmic
    margin = 0.05 if panels[0].is_to_scale or not panels[0].is_function else 0.01
    low, high = panels[0].limits or limits([curve.x for panel in panels for curve in panel.curves], margin, is_log)
    verticals, top = [], PADDING
    for panel, space in zip(panels, above, strict=True):
        top += space
        bottom, top_limit = limits([curve.y for curve in panel.curves], 0.05, "y" in panel.logarithmic)
        bottom = 0.0 if panel.from_zero else bottom if panel.least is None else max(bottom, panel.least)
        verticals.append(Axis(bottom, top_limit, top + each, top, 2.0 * FONT, "y" in panel.logarithmic))
        top += each + GAP
    # the widest number leaves the rest to the panels
    digits = max(sum(CHARACTERS.get(c, DIGIT) for c in text) for axis in verticals for text in axis.labels)
    lines = max(panel.label.count("\n") for panel in panels)
    begin, end = 2 * 8.0 + ROW * lines + FONT * digits + 7.0, width - PADDING
    for panel, axis in zip(panels, verticals, strict=True):
        x, y = Axis(low, high, begin, end, 3.0 * FONT, is_log), axis
        if panel.is_to_scale:
            # the same scale, as large as both axes allow, in the middle of their top
            across, down = x.high - x.low, y.high - y.low
            scale = min((x.end - x.begin) / across, (y.begin - y.end) / down)
            spare = 0.5 * (x.end - x.begin - scale * across)
            x, y = replace(x, begin=x.begin + spare, end=x.end - spare), replace(y, begin=y.end + scale * down)
        yield _Box(x, y)


def _marker(marker: Marker) -> str:
    """Return the disc or square about the origin, and the text beside it."""
    half, style = 0.5 * marker.size, f'fill="{marker.colour}" fill-opacity="{marker.opacity:g}"'
    parts = ""
    if marker.size and marker.shape == "disc":
        parts += f'<circle r="{half:g}" {style}/>'
    elif marker.size:
        parts += f'<rect x="{-half:g}" y="{-half:g}" width="{marker.size:g}" height="{marker.size:g}" {style}/>'
    if marker.text:
        parts += text_at(marker.text, *marker.offset, SMALL, marker.anchor)
    return parts


def _rows(panel: Panel, width: float) -> list[list[Curve]]:
    """Return the curves with a label, in rows that are no wider than the chart."""
    rows, used = list[list[Curve]](), math.inf
    for curve in panel.curves:
        if not curve.label:
            continue
        space = 40.8 + LETTER * ON_PHONES * len(curve.label)
        if used + space > width - PADDING:
            rows.append([])
            used = 0.0
        rows[-1].append(curve)
        used += space
    return rows


def line_path(x: RealArray, y: RealArray) -> str:
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


def stroke(
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


def text_at(
    content: str, x: float, y: float, size: float, anchor: str, colour: str = INK, *, upright: bool = True
) -> str:
    """Return a text with its baseline's start, middle or end at a point."""
    turned = "" if upright else f' transform="rotate(-90 {x:.2f} {y:.2f})"'
    place = f'x="{x:.2f}" y="{y:.2f}" font-size="{size:g}" text-anchor="{anchor}" fill="{colour}"{turned}'
    return f"<text {place}>{escape(content)}</text>"


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


def spread(count: int) -> NDArray[np.intp]:
    """Return at most `MOST_POINTS` equally spaced indices of ``count`` values, first and last included."""
    return np.arange(count) if count <= MOST_POINTS else np.linspace(0, count - 1, MOST_POINTS).astype(np.intp)


def packed(*channels: RealArray) -> str:
    """Return arrays one after the other as base64 of little-endian 32-bit numbers, 24 significant bits each: for zooming and reading."""
    return base64.b64encode(np.concatenate([np.ravel(each) for each in channels]).astype("<f4").tobytes()).decode()


def unpacked(text: str, channels: int) -> RealArray:
    """Return the arrays (channels, N) of `packed`."""
    return np.frombuffer(base64.b64decode(text), dtype="<f4").astype(np.float64).reshape(channels, -1)
