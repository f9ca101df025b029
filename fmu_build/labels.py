"""Placement of labels beside the parts of a drawing, without overlaps.

Greedy placement (Christensen, Marks and Shieber, An empirical study of algorithms for point-feature label placement, ACM TOG 14
(1995)): each label takes the candidate with the fewest overlaps; the direction away from the drawing's middle comes first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import cos, hypot, pi, sin
from typing import Literal

from flexfmu.model.symbolic import Drawing
from flexfmu.trajectories.curves import Point

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


@dataclass(frozen=True)
class Label:
    """A text whose base line starts, ends or is centred at a point [px]."""

    text: str
    at: Point
    anchor: Literal["start", "middle", "end"]

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the text [px]; monospaced letters are 0.6 times as wide as high."""
        width = 0.6 * FONT_SIZE * len(self.text)
        left = self.at[0] - {"start": 0.0, "middle": 0.5, "end": 1.0}[self.anchor] * width
        return left, self.at[1] - 0.75 * FONT_SIZE, left + width, self.at[1] + 0.25 * FONT_SIZE


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
    # names with their points and preferred directions
    named = [(spot.name, at, _between(middle, at)) for spot, at in zip(drawing.spots, points, strict=True)]
    for bar in drawing.bars:
        start, end = view(bar.start), view(bar.end)
        at = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
        named.append((bar.name, at, _across(_between(start, end), _between(middle, at))))
    # the candidate with the fewest overlaps, among those inside the picture
    placed: list[Label] = []
    for name, at, away in named:
        candidates = _candidates(name, at, away)
        placed.append(min(candidates, key=lambda label: (not _is_inside(label, size), _covered(label, placed, stamps))))
    return tuple(placed)


def _candidates(name: str, at: Point, away: Point) -> Iterator[Label]:
    """Yield the label in all directions and distances, in the order of preference."""
    length = hypot(*away) or 1.0
    for turn in _TURNS:
        x = (cos(turn) * away[0] - sin(turn) * away[1]) / length
        y = (sin(turn) * away[0] + cos(turn) * away[1]) / length
        anchor: Literal["start", "middle", "end"] = "middle" if abs(x) < abs(y) else "start" if x > 0.0 else "end"
        for distance in DISTANCES:
            yield Label(name, (at[0] + distance * x, at[1] + distance * y + 0.25 * FONT_SIZE), anchor)


def _is_inside(label: Label, size: Point) -> bool:
    """Whether a label is completely inside the picture."""
    left, top, right, bottom = label.box
    return left >= GAP and top >= GAP and right <= size[0] - GAP and bottom <= size[1] - GAP


def _covered(label: Label, others: Sequence[Label], stamps: Sequence[Stamp]) -> int:
    """Number of labels and circles that a label overlaps."""
    left, top, right, bottom = label.box
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
    return touched


def _between(a: Point, b: Point) -> Point:
    """Vector from one point to another."""
    return b[0] - a[0], b[1] - a[1]


def _across(along: Point, away: Point) -> Point:
    """Vector at right angles to ``along``, on the side of ``away``."""
    side = 1.0 if away[0] * along[1] - away[1] * along[0] > 0 else -1.0
    return side * along[1], -side * along[0]
