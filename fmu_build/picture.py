"""A small picture of lines and discs in pixels: one description for the documentation's SVG and for the icon."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Literal

from flexfmu.model.drawing import Drawing, Part, Point

COLOURS: dict[Part, str] = {
    "proximal": "#1f3a5f",
    "distal": "#3f88c5",
    "motor": "#5c6773",
    "joint": "#1f3a5f",
    "end effector": "#d1495b",
}
"""As in the reports: dark blue, blue, grey, red."""

_RADII: dict[Part, float] = {"motor": 0.050, "joint": 0.022, "end effector": 0.034}
"""Of the spots, in parts of the picture's smaller side."""

_THINNEST = 0.018
"""Of the bars, in parts of the picture's smaller side, so that slender links are seen."""


PEN, FINE_PEN = 0.05, 0.018
"""Of icons, and of larger pictures, in parts of their height."""

PAGE_SIZE = (420, 210)
"""Width and height of the pages' picture of blocks and curves [px]."""

LABEL_DISTANCE, LABEL_DROP = 30.0, 5.0
"""From what a label names to its text, and from the text's middle down to its base line [px]."""

LABEL_ROOM = (125.0, 45.0)
"""Kept free for labels at the sides, and above and below [px]."""


@dataclass(frozen=True)
class Line:
    """Straight line with round ends."""

    start: Point
    end: Point
    width: float
    colour: str


@dataclass(frozen=True)
class Disc:
    """Filled circle."""

    centre: Point
    radius: float
    colour: str


@dataclass(frozen=True)
class Label:
    """Text that starts at a point of its base line, ends there, or has its middle there."""

    text: str
    at: Point
    anchor: Literal["start", "middle", "end"]


@dataclass(frozen=True)
class Picture:
    """Shapes in pixels, y downwards, drawn in this order.

    Attributes:
        width, height: size.
        lines, discs: lines are drawn first.
        labels: on top of them.
    """

    width: int
    height: int
    lines: tuple[Line, ...] = ()
    discs: tuple[Disc, ...] = ()
    labels: tuple[Label, ...] = ()


def mechanism_picture(drawing: Drawing, width: int, height: int, labelled: bool = False) -> Picture:
    """A mechanism, as large as the picture allows; ``labelled`` with the names that the variables use."""
    side = min(width, height)
    margins = LABEL_ROOM if labelled else (0.10 * side, 0.10 * side)
    ends = [point for bar in drawing.bars for point in (bar.start, bar.end)]
    view = _View.around([*ends, *(spot.position for spot in drawing.spots)], width, height, margins)
    lines = [
        Line(view(bar.start), view(bar.end), max(bar.diameter * view.scale, _THINNEST * side), COLOURS[bar.part])
        for bar in drawing.bars
    ]
    discs = [
        Disc(view(spot.position), _RADII[spot.part] * side, COLOURS[spot.part])
        for spot in sorted(drawing.spots, key=lambda spot: -_RADII[spot.part])
    ]
    labels = _labels(drawing, view) if labelled else ()
    return Picture(width, height, tuple(lines), tuple(discs), labels)


def curves_picture(curves: Iterable[Sequence[Point]], width: int, height: int, pen: float = PEN) -> Picture:
    """Curves through points (abscissa, ordinate), each scaled to the whole height, in two colours; the pen in parts of the height."""
    lines: list[Line] = []
    for curve, colour in zip(curves, (COLOURS["proximal"], COLOURS["distal"]), strict=False):
        view = _View.around(curve, width, height, (0.12 * width, 0.12 * height), keep_aspect=False)
        points = [view(point) for point in curve]
        lines += [Line(a, b, pen * height, colour) for a, b in itertools.pairwise(points)]
    return Picture(width, height, tuple(lines))


def block_picture(width: int, height: int, pen: float = PEN) -> Picture:
    """A box with an arrow in and an arrow out, as block diagrams have it; the pen in parts of the height."""
    left, right, top, bottom, middle = 0.3 * width, 0.7 * width, 0.25 * height, 0.75 * height, 0.5 * height
    corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
    dark, light, ink = COLOURS["proximal"], COLOURS["distal"], pen * height
    box = [Line(a, b, ink, dark) for a, b in itertools.pairwise(corners)]
    arrows = [arrow for x in (0.05 * width, right) for arrow in _arrow((x, middle), 0.25 * width, ink, light)]
    return Picture(width, height, (*arrows, *box))


def _arrow(tail: Point, length: float, pen: float, colour: str) -> list[Line]:
    tip, back = (tail[0] + length, tail[1]), 0.4 * length
    wings = [(tip[0] - back, tip[1] + sign * 0.6 * back) for sign in (-1, 1)]
    return [Line(tail, tip, pen, colour), *(Line(wing, tip, pen, colour) for wing in wings)]


def _labels(drawing: Drawing, view: _View) -> tuple[Label, ...]:
    """Names of spots and bars, outside the mechanism: away from its middle, the bars' at right angles to them."""
    named: list[tuple[str, Point, tuple[Point, Point] | None]] = [
        (spot.name, view(spot.position), None) for spot in drawing.spots
    ]
    named += [
        (bar.name, _middle(view(bar.start), view(bar.end)), (view(bar.start), view(bar.end))) for bar in drawing.bars
    ]
    points = [view(spot.position) for spot in drawing.spots]
    middle = sum(x for x, _ in points) / len(points), sum(y for _, y in points) / len(points)
    return tuple(_label(name, at, middle, bar) for name, at, bar in named)


def _label(name: str, at: Point, middle: Point, bar: tuple[Point, Point] | None) -> Label:
    away = (at[0] - middle[0], at[1] - middle[1])
    if bar is not None:
        along = bar[1][0] - bar[0][0], bar[1][1] - bar[0][1]
        side = 1.0 if away[0] * along[1] - away[1] * along[0] > 0 else -1.0
        away = side * along[1], -side * along[0]
    length = hypot(*away) or 1.0
    x, y = (LABEL_DISTANCE * component / length for component in away)
    anchor: Literal["start", "middle", "end"] = "middle" if abs(x) < abs(y) else "start" if x > 0.0 else "end"
    return Label(name, (at[0] + x, at[1] + y + LABEL_DROP), anchor)


def _middle(a: Point, b: Point) -> Point:
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2


@dataclass(frozen=True)
class _View:
    """From the model's lengths to pixels: scaled, turned upside down and centred."""

    scale: float
    scale_y: float
    origin: Point

    @classmethod
    def around(
        cls, points: Sequence[Point], width: int, height: int, margins: Point, keep_aspect: bool = True
    ) -> _View:
        """The view that shows all points within the margins."""
        (left, right), (low, high) = ((min(values), max(values)) for values in zip(*points, strict=True))
        across, up = (
            (width - 2 * margins[0]) / ((right - left) or 1.0),
            (height - 2 * margins[1]) / ((high - low) or 1.0),
        )
        scale, scale_y = (min(across, up),) * 2 if keep_aspect else (across, up)
        return cls(scale, scale_y, (width / 2 - scale * (left + right) / 2, height / 2 + scale_y * (low + high) / 2))

    def __call__(self, point: Point) -> Point:
        return self.origin[0] + self.scale * point[0], self.origin[1] - self.scale_y * point[1]
