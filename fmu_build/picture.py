"""Pictures of lines, discs and labels: the documentation shows them as SVG, this module writes the icon ``model.png``.

The PNG file (ISO/IEC 15948) is written without a drawing library, so that its bytes depend only on the picture and zlib.
Labels are placed greedily (Christensen, Marks and Shieber, An empirical study of algorithms for point-feature label placement, ACM TOG
14 (1995)): each takes the candidate with the fewest overlaps; the direction away from the drawing's middle comes first.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import ceil, cos, hypot, pi, sin
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flexfmu.model.symbolic import Drawing, Part
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.jets import RealArray

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


PEN, FINE_PEN = 0.05, 0.018
"""Line widths for icons and for larger pictures, as a fraction of the height."""

ICON_FILE = "model.png"
"""Path of the icon in the FMU (FMI 2.0.4, section 2.3)."""

ICON_SIZE = 96
"""Width and height of the icon [px]."""

PAGE_SIZE = (420, 210)
"""Width and height of pictures of blocks and curves in the documentation [px]."""


FONT_SIZE = 15.0
"""Font size of the labels [px]."""

DISTANCES = (30.0, 40.0)
"""Candidate distances from the labelled point to the text [px]."""

ROOM = (125.0, 45.0)
"""Margins for labels at the sides, and above and below [px]."""

GAP, LABEL_GAP = 3.0, 12.0
"""Smallest distance between a label and the drawing, and between two labels [px]."""

_TURNS = [sign * step * pi / 12 for step in range(13) for sign in (1, -1)]
"""Angles from the preferred direction of a label to the candidates, in the order of preference [rad]."""

Stamp = tuple[Point, float]
"""A circle that labels must not overlap: centre and radius [px]."""


Anchor = Literal["start", "middle", "end"]


@dataclass(frozen=True)
class Label:
    """A text whose base line starts, ends or is centred at a point [px]."""

    text: str
    at: Point
    anchor: Anchor

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the text [px]; monospaced letters are 0.6 times as wide as high."""
        width = 0.6 * FONT_SIZE * len(self.text)
        left = self.at[0] - {"start": 0.0, "middle": 0.5, "end": 1.0}[self.anchor] * width
        return left, self.at[1] - 0.75 * FONT_SIZE, left + width, self.at[1] + 0.25 * FONT_SIZE


@dataclass(frozen=True)
class Line:
    """Straight line with round ends; lengths in pixels."""

    start: Point
    end: Point
    width: float
    colour: str


@dataclass(frozen=True)
class Disc:
    """Filled circle; lengths in pixels."""

    centre: Point
    radius: float
    colour: str


@dataclass(frozen=True)
class Picture:
    """Shapes in pixels, y downwards.

    Attributes:
        width, height: size [px].
        lines, discs, labels: shapes, drawn in this order.
    """

    width: int
    height: int
    lines: tuple[Line, ...] = ()
    discs: tuple[Disc, ...] = ()
    labels: tuple[Label, ...] = ()


def plant_picture(
    drawing: Drawing | None, width: int = ICON_SIZE, height: int = ICON_SIZE, *, labelled: bool = False
) -> Picture:
    """Picture of a mechanism, scaled to fit, or of a block without a drawing; ``labelled`` adds the names used by the variables."""
    if drawing is None:
        return block_picture(width, height)
    # scaled to fit, with margins for the labels
    side = min(width, height)
    margins = ROOM if labelled else (0.10 * side, 0.10 * side)
    ends = [point for bar in drawing.bars for point in (bar.start, bar.end)]
    view = _View.around([*ends, *(spot.position for spot in drawing.spots)], width, height, margins)
    # bars first, small spots over large ones
    lines = [
        Line(view(bar.start), view(bar.end), max(bar.diameter * view.scale, _THINNEST * side), COLOURS[bar.part])
        for bar in drawing.bars
    ]
    discs = [
        Disc(view(spot.position), _RADII[spot.part] * side, COLOURS[spot.part])
        for spot in sorted(drawing.spots, key=lambda spot: -_RADII[spot.part])
    ]
    labels = place_labels(drawing, view, _stamps(lines, discs), (width, height)) if labelled else ()
    return Picture(width, height, tuple(lines), tuple(discs), labels)


def curves_picture(
    curves: Iterable[Sequence[Point]], width: int = ICON_SIZE, height: int = ICON_SIZE, pen: float = PEN
) -> Picture:
    """Picture of up to two curves through points (abscissa, ordinate), each scaled to the picture.

    Args:
        curves: points of each curve; only the first two are drawn.
        width, height: size of the picture [px].
        pen: line width as a fraction of the height.
    """
    lines: list[Line] = []
    for curve, colour in zip(curves, (COLOURS["proximal"], COLOURS["distal"]), strict=False):
        view = _View.around(curve, width, height, (0.12 * width, 0.12 * height), keep_aspect=False)
        points = [view(point) for point in curve]
        lines += [Line(a, b, pen * height, colour) for a, b in itertools.pairwise(points)]
    return Picture(width, height, tuple(lines))


def block_picture(width: int = ICON_SIZE, height: int = ICON_SIZE, pen: float = PEN) -> Picture:
    """Picture of a block diagram's block with an input and an output arrow; ``pen`` is a fraction of the height."""
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


def _stamps(lines: Sequence[Line], discs: Sequence[Disc]) -> list[Stamp]:
    """Circles that cover the lines and discs."""
    stamps = [(disc.centre, disc.radius) for disc in discs]
    for line in lines:
        across, down = line.end[0] - line.start[0], line.end[1] - line.start[1]
        count = 1 + ceil(2.0 * hypot(across, down) / line.width)
        places = (k / count for k in range(count + 1))
        stamps += [((line.start[0] + s * across, line.start[1] + s * down), line.width / 2) for s in places]
    return stamps


@dataclass(frozen=True)
class _View:
    """Map from the model's lengths to pixels: scaled, mirrored in y and centred."""

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


def place_labels(
    drawing: Drawing, view: Callable[[Point], Point], stamps: Sequence[Stamp], size: Point
) -> tuple[Label, ...]:
    """Place labels for spots and bars, preferably away from the mechanism's middle, for bars at right angles to them.

    Args:
        drawing: the drawing.
        view: map from the drawing's lengths to pixels.
        stamps: circles that cover the drawing.
        size: width and height of the picture [px].
    """
    points = [view(spot.position) for spot in drawing.spots]
    middle = sum(x for x, _ in points) / len(points), sum(y for _, y in points) / len(points)
    # names with their points and preferred directions: for bars at right angles to them
    named = [(spot.name, at, _between(middle, at)) for spot, at in zip(drawing.spots, points, strict=True)]
    for bar in drawing.bars:
        start, end = view(bar.start), view(bar.end)
        at = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
        along, away = _between(start, end), _between(middle, at)
        side = 1.0 if away[0] * along[1] - away[1] * along[0] > 0 else -1.0
        named.append((bar.name, at, (side * along[1], -side * along[0])))
    # the candidate with the fewest overlaps, among those inside the picture
    placed: list[Label] = []
    for name, at, away in named:
        length, candidates = hypot(*away) or 1.0, []
        for turn in _TURNS:
            x = (cos(turn) * away[0] - sin(turn) * away[1]) / length
            y = (sin(turn) * away[0] + cos(turn) * away[1]) / length
            anchor: Anchor = "middle" if abs(x) < abs(y) else "start" if x > 0.0 else "end"
            for distance in DISTANCES:
                place = at[0] + distance * x, at[1] + distance * y + 0.25 * FONT_SIZE
                candidates.append(Label(name, place, anchor))
        placed.append(min(candidates, key=lambda label: _overlaps(label, placed, stamps, size)))
    return tuple(placed)


def _overlaps(label: Label, others: Sequence[Label], stamps: Sequence[Stamp], size: Point) -> tuple[bool, int]:
    """Whether a label is partly outside the picture, and the number of labels and circles that it overlaps."""
    left, top, right, bottom = label.box
    is_outside = left < GAP or top < GAP or right > size[0] - GAP or bottom > size[1] - GAP
    touched = 0
    # circles of the drawing
    for (x, y), radius in stamps:
        across, down = max(left - x, 0.0, x - right), max(top - y, 0.0, y - bottom)
        touched += hypot(across, down) < radius + GAP
    # labels placed before
    for other in others:
        its_left, its_top, its_right, its_bottom = other.box
        beside = max(its_left - right, left - its_right)
        touched += max(beside, its_top - bottom, top - its_bottom) < LABEL_GAP
    return is_outside, touched


def _between(a: Point, b: Point) -> Point:
    """Vector from one point to another."""
    return b[0] - a[0], b[1] - a[1]


def png(picture: Picture) -> bytes:
    """The picture as a PNG file, without labels, on a transparent background, with antialiased edges."""
    image = np.zeros((picture.height, picture.width, 4))
    for line in picture.lines:
        _paint(image, _distance(image, line.start, line.end) - line.width / 2, line.colour)
    for disc in picture.discs:
        _paint(image, _distance(image, disc.centre, disc.centre) - disc.radius, disc.colour)
    return _encode(np.rint(255 * image).astype(np.uint8))


def _distance(image: RealArray, start: Point, end: Point) -> RealArray:
    """Distance of each pixel's centre from the line segment between two points [px], shape (rows, columns)."""
    y, x = np.indices(image.shape[:2]) + 0.5
    along = np.subtract(end, start)
    offset = np.stack([x - start[0], y - start[1]], axis=-1)
    square = float(along @ along)
    fraction = np.clip(offset @ along / square, 0.0, 1.0) if square else np.zeros_like(x)
    return np.asarray(np.linalg.norm(offset - fraction[..., None] * along, axis=-1))


def _paint(image: RealArray, outside: RealArray, colour: str) -> None:
    """Blend a colour into the RGBA image where the signed distance ``outside`` is negative."""
    cover = np.clip(0.5 - outside, 0.0, 1.0)[..., None]
    ink = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    opacity = cover + image[..., 3:] * (1.0 - cover)
    mixed = cover * ink + image[..., :3] * image[..., 3:] * (1.0 - cover)
    image[..., :3] = np.divide(mixed, opacity, out=np.zeros_like(mixed), where=opacity > 0.0)
    image[..., 3:] = opacity


def _encode(pixels: NDArray[np.uint8]) -> bytes:
    """RGBA pixels (rows, columns, 4) as a PNG file (ISO/IEC 15948), without metadata."""
    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in chunks
    )
