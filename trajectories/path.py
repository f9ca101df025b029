"""The pick-and-place path (half of an Adept cycle): up, across and down, with blended corners, and the blends.

A blend starts at the origin in the direction of the lift (second axis), turns by 90 degrees and ends at (width, height) in the
direction of the crossing (first axis). Its curvature is zero at both ends. To add a kind, write a class and add it to `BLENDS`.

Sources: C. J. Barnard, S. Briot, S. Caro, ESDA 2012, section 3 (all three); W. Nelson, *Continuous-curvature paths for
autonomous vehicles*, ICRA 1989 (polar polynomial).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from numpy.typing import ArrayLike

from flexfmu.trajectories import curves
from flexfmu.trajectories.errors import TrajectoryError, plane_vector, positive
from flexfmu.trajectories.jets import Jet, RealArray, power, sincos, stack, unstack
from flexfmu.trajectories.roots import root_between

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

    start: curves.Point
    lift: curves.Point
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
    def lift_direction(self) -> curves.Point:
        """Unit vector along the lift."""
        # scale first, so that squares neither overflow nor underflow
        largest = max(abs(self.lift[0]), abs(self.lift[1]))
        x, y = self.lift[0] / largest, self.lift[1] / largest
        return x / math.hypot(x, y), y / math.hypot(x, y)

    @property
    def crossing_direction(self) -> curves.Point:
        """Unit vector along the crossing."""
        x, y = self.lift_direction
        if abs(y) <= FIT:
            return -y * math.copysign(1.0, x), abs(x)
        return abs(y), -x * math.copysign(1.0, y)

    @cached_property
    def pieces(self) -> tuple[curves.PlacedPiece, ...]:
        """The pieces of the path; straight parts of length zero are left out."""
        lift, across = self.lift_direction, self.crossing_direction
        back = -across[0], -across[1]
        rise, run = self.height - self.blend.height, self.width - 2.0 * self.blend.width
        upright: tuple[curves.Piece, ...] = (curves.StraightLine(rise),) if rise > FIT * self.height else ()
        level: tuple[curves.Piece, ...] = (curves.StraightLine(run),) if run > FIT * self.width else ()
        corner = self.blend.curve.pieces
        # up, with the corner on top of the straight part
        pieces = [curves.PlacedPiece(piece, self.start, across, lift) for piece in upright]
        pieces += [curves.PlacedPiece(piece, self._point(0.0, rise), across, lift) for piece in corner]
        # across; the second axis of a straight line is its direction
        pieces += [
            curves.PlacedPiece(piece, self._point(self.blend.width, self.height), lift, across) for piece in level
        ]
        # down: the mirror image of the way up, traversed backwards
        pieces += [
            curves.PlacedPiece(piece, self._point(self.width, rise), back, lift, True) for piece in reversed(corner)
        ]
        pieces += [curves.PlacedPiece(piece, self.end, back, lift, True) for piece in upright]
        return tuple(pieces)

    @cached_property
    def curve(self) -> curves.PiecewiseCurve:
        """The path by arc length."""
        return curves.PiecewiseCurve(self.pieces)

    @property
    def length(self) -> float:
        """Length [m]."""
        return self.curve.length

    @property
    def knots(self) -> tuple[float, ...]:
        """Arc lengths [m] at which a derivative of some order jumps."""
        return self.curve.knots

    @property
    def end(self) -> curves.Point:
        """End point (x, y) [m]."""
        return self._point(self.width, 0.0)

    def jets(self, s: ArrayLike, order: int = 2, side: curves.Side = "right") -> curves.PlaneJets:
        """Return x and y [m] and their derivatives by arc length at s [m]; see `PiecewiseCurve.jets`."""
        return self.curve.jets(s, order, side)

    def _point(self, across: float, up: float) -> curves.Point:
        """Return the point (x, y) [m] at distances ``across`` along the crossing and ``up`` along the lift from the start [m]."""
        (cx, cy), (lx, ly) = self.crossing_direction, self.lift_direction
        return self.start[0] + across * cx + up * lx, self.start[1] + across * cy + up * ly


def _check_fit(name: str, extent: float, room_name: str, room: float) -> None:
    if extent > room * (1.0 + FIT):
        raise TrajectoryError(
            f"blend {name} = {extent:g} m must be at most {room_name}, {room:g} m; "
            "choose a smaller blend or a larger path, or the blends overlap"
        )


QUARTER = 0.5 * math.pi
"""The turning of a blend [rad]."""

LOWEST_RATIO, HIGHEST_RATIO = 0.5621, 1.7790
"""Limits of a clothoid pair's e/d, exclusive. At 0.561948 and 1.779526 one clothoid of the pair vanishes; within these limits the
shorter one turns by more than 0.03 degrees."""


@dataclass(frozen=True)
class Blend(ABC):
    """A corner of height d along the lift and width e along the crossing.

    Attributes:
        height: d [m].
        width: e [m].

    Raises:
        TrajectoryError: height or width is not positive and finite, or no blend of this kind has this ratio e/d.
    """

    height: float
    width: float

    def __post_init__(self) -> None:
        positive("blend height d", self.height, "m")
        positive("blend width e", self.width, "m")

    @property
    @abstractmethod
    def curve(self) -> curves.PiecewiseCurve:
        """The blend by arc length; coordinates are along the crossing and along the lift [m]."""


@dataclass(frozen=True)
class LameBlend(Blend):
    """Lamé curve of order three: ((e - x)/e)³ + (y/d)³ = 1.

    The parametrisation ((e - x)/e, y/d) = (cos t, sin t) / (cos³t + sin³t)^(1/3), 0 ≤ t ≤ π/2, is analytic up to both ends, so
    that all one-sided derivatives there are exact. It is symmetric in the two axes.
    """

    @cached_property
    def curve(self) -> curves.PiecewiseCurve:
        """See `Blend`."""
        return curves.PiecewiseCurve((curves.ParametricPiece(self._point, QUARTER),))

    def _point(self, t: Jet) -> curves.PlaneJets:
        direction = stack(sincos(t))
        s3, c3 = unstack(direction * direction * direction)
        s, c = unstack(direction * power(c3 + s3, -1.0 / 3.0))
        return self.width * (1.0 - c), self.height * s


@dataclass(frozen=True)
class PolarPolynomial(Blend):
    """Polar polynomial r(φ) = R (1 + φ²/2 - φ³/Φ + φ⁴/(2Φ²)) with Φ = π/2, scaled to d and e.

    For d ≠ e the blend is the affine image of the symmetric one.
    """

    @cached_property
    def curve(self) -> curves.PiecewiseCurve:
        """See `Blend`."""
        return curves.PiecewiseCurve((curves.ParametricPiece(self._point, QUARTER),))

    def _point(self, phi: Jet) -> curves.PlaneJets:
        s, c = sincos(phi)
        radius = 1.0 + phi * phi * (0.5 + phi * (phi * (0.5 / QUARTER**2) - 1.0 / QUARTER))
        return self.width * (1.0 - c * radius), self.height * (s * radius)


@dataclass(frozen=True)
class Clothoid:
    """A clothoid from the origin along the second axis, turning towards the first.

    Its heading from the second axis is turning · (s/length)², so that its curvature is 2 turning s / length².

    Attributes:
        length: length [m].
        turning: heading at the end [rad].
    """

    length: float
    turning: float

    def jets(self, s: RealArray, order: int) -> curves.PlaneJets:
        """See `flexfmu.trajectories.curves.Piece`; the position is a pair of Fresnel integrals."""
        from scipy.special import fresnel  # here, since reading a scene needs no scipy

        # the Fresnel integrals run over (s/length) sqrt(2 turning / π)
        unit = self.length * math.sqrt(QUARTER / self.turning)
        across, along = fresnel(s / unit)
        if order == 0:
            return Jet(unit * across[None]), Jet(unit * along[None])
        # integrate the tangent, known in closed form, from the position
        fraction = Jet.variable(s, order - 1) / self.length
        sine, cosine = sincos(self.turning * fraction * fraction)
        return sine.integrate(unit * across), cosine.integrate(unit * along)


@dataclass(frozen=True)
class ClothoidPair(Blend):
    """Two clothoids that turn by α and π/2 - α; the curvature rises linearly in arc length from 0 to k and falls back to 0.

    The pair exists for 0.5621 < e/d < 1.7790.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        # beyond these limits there is no such pair
        ratio = self.width / self.height
        if not LOWEST_RATIO < ratio < HIGHEST_RATIO:
            raise TrajectoryError(
                f"a clothoid pair needs {LOWEST_RATIO:.4f} < e/d < {HIGHEST_RATIO:.4f}, got e/d = {ratio:.6g} "
                f"(e = {self.width:g} m, d = {self.height:g} m); for d = {self.height:g} m choose e between "
                f"{LOWEST_RATIO * self.height:.6g} m and {HIGHEST_RATIO * self.height:.6g} m"
            )

    @cached_property
    def first_turning(self) -> float:
        """α [rad], the turning of the first clothoid; π/4 for e = d."""
        ratio = self.width / self.height
        return root_between(lambda a: aspect_ratio(a) - ratio, 0.0, QUARTER, absolute=1e-16)

    @cached_property
    def curve(self) -> curves.PiecewiseCurve:
        """See `Blend`."""
        # both clothoids have the same smallest radius of curvature, which scales the unit pair to the area e d
        first = self.first_turning
        width, height = unit_extent(first)
        radius = math.sqrt(self.width * self.height / (width * height))
        rising = Clothoid(2.0 * first * radius, first)
        falling = Clothoid(2.0 * (QUARTER - first) * radius, QUARTER - first)
        # the second one starts at the end of the blend and is traversed backwards
        end = curves.PlacedPiece(falling, (self.width, self.height), (0.0, -1.0), (-1.0, 0.0), backwards=True)
        return curves.PiecewiseCurve((rising, end))


def unit_extent(first_turning: float) -> tuple[float, float]:
    """Return width and height of the clothoid pair with peak curvature 1 whose first clothoid turns by ``first_turning`` [rad]."""
    from scipy.special import fresnel

    def end(turning: float) -> tuple[float, float]:
        """End point of a clothoid, across and along its start tangent."""
        across, along = fresnel(math.sqrt(turning / QUARTER))
        unit = 2.0 * math.sqrt(turning * QUARTER)
        return unit * float(across), unit * float(along)

    # the second one, traversed backwards, has the axes exchanged
    (across_1, along_1), (across_2, along_2) = end(first_turning), end(QUARTER - first_turning)
    return across_1 + along_2, along_1 + across_2


def aspect_ratio(first_turning: float) -> float:
    """Return e/d of the clothoid pair whose first clothoid turns by ``first_turning`` [rad]; it falls from 1.7795 to 0.5619."""
    width, height = unit_extent(first_turning)
    return width / height


class BlendKind(NamedTuple):
    """A kind of blend that scene files can name.

    Attributes:
        label: name in the report.
        make: (height d, width e) [m] → blend.
    """

    label: str
    make: Callable[[float, float], Blend]


BLENDS: Mapping[str, BlendKind] = {
    "lame": BlendKind("Lamé", LameBlend),
    "clothoid": BlendKind("clothoid", ClothoidPair),
    "polar": BlendKind("polar polynomial", PolarPolynomial),
}
"""Name in the scene file → kind of blend."""
