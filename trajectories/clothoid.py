"""The clothoid pair: a blend whose curvature rises and falls linearly with arc length."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.special import fresnel

from flexfmu.trajectories.blends import QUARTER
from flexfmu.trajectories.checks import positive
from flexfmu.trajectories.curves import PiecewiseCurve, PlacedPiece, PlaneJets
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import Jet, RealArray, sincos

LOWEST_RATIO, HIGHEST_RATIO = 0.5621, 1.7790
"""Limits of e/d, exclusive. The geometry ends at 0.561948 and 1.779526, where one part of the pair has vanished and a
single clothoid is left; these limits keep the shorter part at more than 0.03 degrees of turning."""


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

    def jets(self, s: RealArray, order: int) -> PlaneJets:
        """See `flexfmu.trajectories.curves.Piece`; the position is a pair of Fresnel integrals."""
        unit = self.length * math.sqrt(QUARTER / self.turning)
        across, along = fresnel(s / unit)
        if order == 0:
            return Jet(unit * across[None]), Jet(unit * along[None])
        fraction = Jet.variable(s, order - 1) / self.length
        sine, cosine = sincos(self.turning * fraction * fraction)
        return sine.integrate(unit * across), cosine.integrate(unit * along)


@dataclass(frozen=True)
class ClothoidPair:
    """Two clothoids with the curvature 0 → k → 0, linear in arc length on each, turning α and π/2 - α.

    Attributes:
        height: d [m].
        width: e [m]; 0.5621 < e/d < 1.7790.
    """

    height: float
    width: float

    def __post_init__(self) -> None:
        positive("blend height d", self.height, "m")
        positive("blend width e", self.width, "m")
        ratio = self.width / self.height
        if not LOWEST_RATIO < ratio < HIGHEST_RATIO:
            raise TrajectoryError(
                f"a clothoid pair needs {LOWEST_RATIO:.4f} < e/d < {HIGHEST_RATIO:.4f}, got e/d = {ratio:.6g} "
                f"(e = {self.width:g} m, d = {self.height:g} m); for d = {self.height:g} m choose e between "
                f"{LOWEST_RATIO * self.height:.6g} m and {HIGHEST_RATIO * self.height:.6g} m"
            )

    @cached_property
    def first_turning(self) -> float:
        """α [rad]: how far the first clothoid turns; π/4 when e = d."""
        ratio = self.width / self.height
        return float(brentq(lambda a: aspect_ratio(a) - ratio, 0.0, QUARTER, xtol=1e-16, rtol=4 * np.finfo(float).eps))

    @cached_property
    def curve(self) -> PiecewiseCurve:
        """See `flexfmu.trajectories.blends.Blend`."""
        first = self.first_turning
        width, height = unit_extent(first)
        radius = math.sqrt(self.width * self.height / (width * height))
        rising, falling = (
            Clothoid(2.0 * first * radius, first),
            Clothoid(2.0 * (QUARTER - first) * radius, QUARTER - first),
        )
        end = PlacedPiece(falling, (self.width, self.height), (0.0, -1.0), (-1.0, 0.0), backwards=True)
        return PiecewiseCurve((rising, end))


def unit_extent(first_turning: float) -> tuple[float, float]:
    """Width and height of the pair with peak curvature 1 whose first clothoid turns by ``first_turning`` [rad]."""
    second_turning = QUARTER - first_turning
    across_1, along_1 = _end(first_turning)
    across_2, along_2 = _end(second_turning)
    return across_1 + along_2, along_1 + across_2


def aspect_ratio(first_turning: float) -> float:
    """e/d of the pair whose first clothoid turns by ``first_turning`` [rad], falling from 1.7795 to 0.5619."""
    width, height = unit_extent(first_turning)
    return width / height


def _end(turning: float) -> tuple[float, float]:
    """End point (across, along the start tangent) of the clothoid that turns so far and ends with curvature 1."""
    across, along = fresnel(math.sqrt(turning / QUARTER))
    unit = 2.0 * math.sqrt(turning * QUARTER)
    return unit * float(across), unit * float(along)
