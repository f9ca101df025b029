"""Pictures of lines and labels for an FMU's documentation, which shows them as SVG."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Literal

import numpy as np

from flexfmu.model.symbolic import Drawing, Part
from flexfmu.trajectories.curves import Point

COLOURS: dict[Part, str] = {
    "proximal": "#1f3a5f",
    "distal": "#3f88c5",
    "motor": "#5c6773",
    "joint": "#1f3a5f",
    "end effector": "#d1495b",
}
"""Part → colour, as in the reports."""

_RADII: dict[Part, float] = {"motor": 0.050, "joint": 0.022, "end effector": 0.034}
"""Part → radius of its spots, as a fraction of the picture's smaller side."""

_THINNEST = 0.018
"""Smallest width of the bars, as a fraction of the picture's smaller side, so that slender links are visible."""


PEN = 0.018
"""Line width of blocks and curves, as a fraction of the height."""

PLANT_SIZE = (560, 420)
"""Width and height of the picture of a mechanism [px]."""

PAGE_SIZE = (420, 210)
"""Width and height of pictures of blocks and curves [px]."""


FONT_SIZE = 15.0
"""Font size of the labels [px]."""

DISTANCE = 35.0
"""Distance from the labelled point to the text [px]."""

ROOM = (125.0, 45.0)
"""Margins for labels at the sides, and above and below [px]."""

Anchor = Literal["start", "middle", "end"]


@dataclass(frozen=True)
class Label:
    """A text whose base line starts, ends or is centred at a point [px]."""

    text: str
    at: Point
    anchor: Anchor


@dataclass(frozen=True)
class Line:
    """Straight line with round ends, or a disc if both are the same point; lengths in pixels."""

    start: Point
    end: Point
    width: float
    colour: str


@dataclass(frozen=True)
class Picture:
    """Shapes in pixels, y downwards.

    Attributes:
        width, height: size [px].
        lines, labels: shapes, drawn in this order.
    """

    width: int
    height: int
    lines: tuple[Line, ...] = ()
    labels: tuple[Label, ...] = ()


def plant_picture(drawing: Drawing | None) -> Picture:
    """Picture of a mechanism, scaled to fit, with the names used by the variables; or of a block without a drawing."""
    if drawing is None:
        return block_picture()
    # scaled to fit, with margins for the labels
    width, height = PLANT_SIZE
    side = min(width, height)
    ends = [point for bar in drawing.bars for point in (bar.start, bar.end)]
    view, scale = _fitted([*ends, *(spot.position for spot in drawing.spots)], width, height, ROOM)
    # bars first, small spots over large ones
    lines = [
        Line(view(bar.start), view(bar.end), max(bar.diameter * scale, _THINNEST * side), COLOURS[bar.part])
        for bar in drawing.bars
    ]
    for spot in sorted(drawing.spots, key=lambda spot: -_RADII[spot.part]):
        at = view(spot.position)
        lines += [Line(at, at, 2.0 * _RADII[spot.part] * side, COLOURS[spot.part])]
    # names on the bars, and beside the spots, away from the middle
    labels, middle = list[Label](), np.mean([view(spot.position) for spot in drawing.spots], axis=0)
    for bar in drawing.bars:
        start, end = view(bar.start), view(bar.end)
        labels.append(Label(bar.name, ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2 + 0.25 * FONT_SIZE), "middle"))
    for spot in drawing.spots:
        spot_at = np.array(view(spot.position))
        x, y = (spot_at - middle) / (hypot(*(spot_at - middle)) or 1.0)
        anchor: Anchor = "middle" if abs(x) < abs(y) else "start" if x > 0.0 else "end"
        labels.append(
            Label(spot.name, (spot_at[0] + DISTANCE * x, spot_at[1] + DISTANCE * y + 0.25 * FONT_SIZE), anchor)
        )
    return Picture(width, height, tuple(lines), tuple(labels))


def curves_picture(curves: Iterable[Sequence[Point]]) -> Picture:
    """Picture of the first two curves, each through points (abscissa, ordinate) and scaled to the picture."""
    width, height = PAGE_SIZE
    lines: list[Line] = []
    for curve, colour in zip(curves, (COLOURS["proximal"], COLOURS["distal"]), strict=False):
        view, _ = _fitted(curve, width, height, (0.12 * width, 0.12 * height), keep_aspect=False)
        points = [view(point) for point in curve]
        lines += [Line(a, b, PEN * height, colour) for a, b in itertools.pairwise(points)]
    return Picture(width, height, tuple(lines))


def block_picture() -> Picture:
    """Picture of a block diagram's block with an input and an output arrow."""
    width, height = PAGE_SIZE
    left, right, top, bottom, middle = 0.3 * width, 0.7 * width, 0.25 * height, 0.75 * height, 0.5 * height
    corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
    dark, light, ink = COLOURS["proximal"], COLOURS["distal"], PEN * height
    box = [Line(a, b, ink, dark) for a, b in itertools.pairwise(corners)]
    arrows = [arrow for x in (0.05 * width, right) for arrow in _arrow((x, middle), 0.25 * width, ink, light)]
    return Picture(width, height, (*arrows, *box))


def _arrow(tail: Point, length: float, pen: float, colour: str) -> list[Line]:
    tip, back = (tail[0] + length, tail[1]), 0.4 * length
    wings = [(tip[0] - back, tip[1] + sign * 0.6 * back) for sign in (-1, 1)]
    return [Line(tail, tip, pen, colour), *(Line(wing, tip, pen, colour) for wing in wings)]


def _fitted(
    points: Sequence[Point], width: int, height: int, margins: Point, keep_aspect: bool = True
) -> tuple[Callable[[Point], Point], float]:
    """Map from the model's lengths to pixels, mirrored in y, that shows all points centred within the margins; and its scale in x."""
    (left, right), (low, high) = ((min(values), max(values)) for values in zip(*points, strict=True))
    across = (width - 2 * margins[0]) / ((right - left) or 1.0)
    up = (height - 2 * margins[1]) / ((high - low) or 1.0)
    if keep_aspect:
        across = up = min(across, up)
    x0, y0 = width / 2 - across * (left + right) / 2, height / 2 + up * (low + high) / 2
    return lambda point: (x0 + across * point[0], y0 - up * point[1]), across
