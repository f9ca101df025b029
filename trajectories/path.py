"""The pick-and-place path (half of an Adept cycle): up, across and down, with blended corners."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from numpy.typing import ArrayLike

from flexfmu.trajectories.blends import Blend
from flexfmu.trajectories.curves import (
    Piece,
    PiecewiseCurve,
    PlacedPiece,
    PlaneJets,
    Point,
    Side,
    StraightLine,
)
from flexfmu.trajectories.errors import TrajectoryError, plane_vector, positive

FIT = 1e-12
"""Relative tolerance for rounding: by so much a blend may exceed its limit, and straight parts shorter than this are left out."""


@dataclass(frozen=True)
class PickAndPlacePath:
    """A path from ``start`` along ``lift`` by ``height``, across by ``width``, and back down by ``height``.

    The crossing is perpendicular to the lift, towards positive x; for a lift along x, towards positive y.

    Attributes:
        start: start point (x, y) [m].
        lift: direction of the lift, a nonzero vector of any length.
        height: height of the lift [m], at least that of the blend.
        width: distance between start and end [m], at least twice the width of the blend.
        blend: shape of both corners; the second corner is the mirror image of the first.

    Raises:
        TrajectoryError: a value is not finite or not positive, the lift is (0, 0), or the blends do not fit.
    """

    start: Point
    lift: Point
    height: float
    width: float
    blend: Blend

    def __post_init__(self) -> None:
        # store plain pairs of any sequences
        object.__setattr__(self, "start", plane_vector("path start", self.start, "m"))
        object.__setattr__(self, "lift", plane_vector("path lift", self.lift, "1"))
        if self.lift == (0.0, 0.0):
            raise TrajectoryError("path lift must be a direction other than (0, 0), for example (0, 1)")
        positive("path height", self.height, "m")
        positive("path width", self.width, "m")
        # the blends must not overlap
        _check_fit("height d", self.blend.height, "the path's height", self.height)
        _check_fit("width e", self.blend.width, "half the path's width", 0.5 * self.width)

    @property
    def lift_direction(self) -> Point:
        """Unit vector along the lift."""
        # scale first, so that squares neither overflow nor underflow
        largest = max(abs(self.lift[0]), abs(self.lift[1]))
        x, y = self.lift[0] / largest, self.lift[1] / largest
        return x / math.hypot(x, y), y / math.hypot(x, y)

    @property
    def crossing_direction(self) -> Point:
        """Unit vector along the crossing."""
        x, y = self.lift_direction
        if abs(y) <= FIT:
            return -y * math.copysign(1.0, x), abs(x)
        return abs(y), -x * math.copysign(1.0, y)

    @cached_property
    def pieces(self) -> tuple[PlacedPiece, ...]:
        """The pieces of the path; straight parts of length zero are left out."""
        lift, across = self.lift_direction, self.crossing_direction
        back = -across[0], -across[1]
        rise, run = self.height - self.blend.height, self.width - 2.0 * self.blend.width
        upright: tuple[Piece, ...] = (StraightLine(rise),) if rise > FIT * self.height else ()
        level: tuple[Piece, ...] = (StraightLine(run),) if run > FIT * self.width else ()
        corner = self.blend.curve.pieces
        # up, with the corner on top of the straight part
        pieces = [PlacedPiece(piece, self.start, across, lift) for piece in upright]
        pieces += [PlacedPiece(piece, self._point(0.0, rise), across, lift) for piece in corner]
        # across; the second axis of a straight line is its direction
        pieces += [PlacedPiece(piece, self._point(self.blend.width, self.height), lift, across) for piece in level]
        # down: the mirror image of the way up, traversed backwards
        pieces += [PlacedPiece(piece, self._point(self.width, rise), back, lift, True) for piece in reversed(corner)]
        pieces += [PlacedPiece(piece, self.end, back, lift, True) for piece in upright]
        return tuple(pieces)

    @cached_property
    def curve(self) -> PiecewiseCurve:
        """The path by arc length."""
        return PiecewiseCurve(self.pieces)

    @property
    def length(self) -> float:
        """Length [m]."""
        return self.curve.length

    @property
    def knots(self) -> tuple[float, ...]:
        """Arc lengths [m] at which a derivative of some order jumps."""
        return self.curve.knots

    @property
    def end(self) -> Point:
        """End point (x, y) [m]."""
        return self._point(self.width, 0.0)

    def jets(self, s: ArrayLike, order: int = 2, side: Side = "right") -> PlaneJets:
        """Return x and y [m] and their derivatives by arc length at s [m]; see `PiecewiseCurve.jets`."""
        return self.curve.jets(s, order, side)

    def _point(self, across: float, up: float) -> Point:
        """Return the point (x, y) [m] at distances ``across`` along the crossing and ``up`` along the lift from the start [m]."""
        (cx, cy), (lx, ly) = self.crossing_direction, self.lift_direction
        return self.start[0] + across * cx + up * lx, self.start[1] + across * cy + up * ly


def _check_fit(name: str, extent: float, room_name: str, room: float) -> None:
    if extent > room * (1.0 + FIT):
        raise TrajectoryError(
            f"blend {name} = {extent:g} m must be at most {room_name}, {room:g} m; "
            "choose a smaller blend or a larger path, or the blends overlap"
        )
