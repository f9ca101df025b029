"""Labels beside the points of a diagram, moved apart so that each can be read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from flexfmu.cosim.measuring.bernstein import Array
from flexfmu.cosim.reports.figure_style import GREY

FONT_SIZE = 5.5

PLACES = (
    (3.0, 3.0, "left", "bottom"),
    (-3.0, 3.0, "right", "bottom"),
    (3.0, -3.0, "left", "top"),
    (-3.0, -3.0, "right", "top"),
    (0.0, 5.0, "center", "bottom"),
    (0.0, -5.0, "center", "top"),
    (6.0, 0.0, "left", "center"),
    (-6.0, 0.0, "right", "center"),
    (0.0, 12.0, "center", "bottom"),
    (0.0, -12.0, "center", "top"),
)
"""Where a label may stand: from its point [pt], and which side or corner of the text is there; the usual place first."""

CLEARANCE = 2.0
"""Around every point [px]."""

Box = tuple[float, float, float, float]
"""Left, bottom, right, top [px]."""


def label_points(axes: Axes, points: Array, texts: Iterable[str]) -> None:
    """Write a text beside each of the points, shape (n, 2), in the usual place."""
    x, y, across, upright = PLACES[0]
    for point, text in zip(points, texts, strict=True):
        axes.annotate(
            text, point, (x, y), textcoords="offset points", ha=across, va=upright, fontsize=FONT_SIZE, color=GREY
        )


def keep_apart(figure: Figure) -> None:
    """Move the labels of all diagrams where they cover neither each other nor points nor legend, and few lines.

    A label for which there is no such place is left out; tables have all settings.
    """
    figure.draw_without_rendering()  # sizes are known from here on
    for axes in figure.axes:
        taken = []
        if (legend := axes.get_legend()) is not None:
            taken.append(_box(legend))
            legend.set_loc(tuple(axes.transAxes.inverted().transform(taken[0][:2])))  # it would follow the labels
        points, lines = _drawn(axes)
        taken += [(x - CLEARANCE, y - CLEARANCE, x + CLEARANCE, y + CLEARANCE) for x, y in points]
        for label in [each for each in axes.texts if isinstance(each, Annotation)]:
            box = _move(label, _box(axes), taken, lines)
            label.set_visible(box is not None)
            taken += [box] if box is not None else []


def _move(label: Annotation, frame: Box, taken: Sequence[Box], lines: Array) -> Box | None:
    """Put a label where it crosses the fewest lines, the usual place first; None where every place is taken."""
    free = []
    for place in PLACES:
        _put(label, place)
        box = _box(label)
        inside = box[0] >= frame[0] and box[1] >= frame[1] and box[2] <= frame[2] and box[3] <= frame[3]
        if inside and not any(_overlap(box, other) for other in taken):
            free.append((_count(lines, box), place, box))
    if not free:
        return None
    _, place, box = min(free, key=lambda each: each[0])
    _put(label, place)
    return box


def _put(label: Annotation, place: tuple[float, float, str, str]) -> None:
    x, y, across, upright = place
    label.xyann = (x, y)
    label.set(ha=across, va=upright)


def _box(artist: Any) -> Box:
    """What an artist covers."""
    return tuple(artist.get_window_extent().extents)


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _count(points: Array, box: Box) -> int:
    """How many points, shape (n, 2), lie within a box."""
    return int(np.count_nonzero(((points > box[:2]) & (points < box[2:])).all(axis=1)))


def _drawn(axes: Axes) -> tuple[Array, Array]:
    """All points of the lines, and places along the lines, each of shape (n, 2) [px]."""
    points, places = [np.empty((0, 2))], [np.empty((0, 2))]
    for line in axes.lines:
        corners = line.get_transform().transform(np.column_stack(line.get_data()).astype(float))
        points.append(corners)
        for start, end in pairwise(corners):
            shares = np.linspace(0.0, 1.0, 1 + int(np.hypot(*(end - start))))[:, np.newaxis]
            places.append((1.0 - shares) * start + shares * end)
    return np.concatenate(points), np.concatenate(places)
