"""What a mechanism looks like in its start pose: bars and points in metres, for whoever wants to draw it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Point = tuple[float, float]
Part = Literal["proximal", "distal", "motor", "joint", "end effector"]


@dataclass(frozen=True)
class Bar:
    """A link.

    Attributes:
        name: as the variables call it.
        part: which kind of link.
        start, end: its ends [m].
        diameter: [m].
    """

    name: str
    part: Part
    start: Point
    end: Point
    diameter: float


@dataclass(frozen=True)
class Spot:
    """A point with a name, [m]."""

    name: str
    part: Part
    position: Point


@dataclass(frozen=True)
class Drawing:
    """A mechanism in its start pose."""

    bars: tuple[Bar, ...]
    spots: tuple[Spot, ...]
