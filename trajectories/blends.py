"""Blends: smooth corners of the pick-and-place path.

A blend starts at the origin along the lift (second axis), turns by 90 degrees and ends at (width, height) along the
crossing (first axis). Its curvature is zero at both ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from flexfmu.trajectories.checks import positive
from flexfmu.trajectories.curves import ParametricPiece, PiecewiseCurve, PlaneJets
from flexfmu.trajectories.jets import Jet, power, sincos

QUARTER = 0.5 * math.pi


class Blend(Protocol):
    """A corner of height d along the lift and width e along the crossing."""

    @property
    def height(self) -> float:
        """Extent d along the lift [m]."""
        ...

    @property
    def width(self) -> float:
        """Extent e along the crossing [m]."""
        ...

    @property
    def curve(self) -> PiecewiseCurve:
        """The blend by arc length; coordinates are along the crossing and along the lift [m]."""
        ...


@dataclass(frozen=True)
class LameBlend:
    """Lamé curve of order three: ((e - x)/e)³ + (y/d)³ = 1.

    The parametrisation (e - x)/e, y/d = (cos t, sin t) / (cos³t + sin³t)^(1/3) is analytic over the closed quarter,
    so that all one-sided derivatives at the ends are exact, and symmetric in the two axes.

    Source: Barnard, Briot, Caro, ESDA 2012, section 3.

    Attributes:
        height: d [m].
        width: e [m].
    """

    height: float
    width: float

    def __post_init__(self) -> None:
        _check_extent(self)

    @cached_property
    def curve(self) -> PiecewiseCurve:
        """See `Blend`."""
        return PiecewiseCurve((ParametricPiece(self._point, QUARTER),))

    def _point(self, t: Jet) -> PlaneJets:
        s, c = sincos(t)
        radius = power(c * c * c + s * s * s, -1.0 / 3.0)
        return self.width * (1.0 - c * radius), self.height * (s * radius)


@dataclass(frozen=True)
class PolarPolynomial:
    """Polar polynomial r(φ) = R (1 + φ²/2 - φ³/Φ + φ⁴/(2Φ²)) with Φ = π/2, scaled to d and e.

    Where d and e differ the blend is the affine image of the symmetric one.

    Source: W. Nelson, *Continuous-curvature paths for autonomous vehicles*, ICRA 1989.

    Attributes:
        height: d [m].
        width: e [m].
    """

    height: float
    width: float

    def __post_init__(self) -> None:
        _check_extent(self)

    @cached_property
    def curve(self) -> PiecewiseCurve:
        """See `Blend`."""
        return PiecewiseCurve((ParametricPiece(self._point, QUARTER),))

    def _point(self, phi: Jet) -> PlaneJets:
        s, c = sincos(phi)
        radius = 1.0 + phi * phi * (0.5 + phi * (phi * (0.5 / QUARTER**2) - 1.0 / QUARTER))
        return self.width * (1.0 - c * radius), self.height * (s * radius)


def _check_extent(blend: Blend) -> None:
    positive("blend height d", blend.height, "m")
    positive("blend width e", blend.width, "m")
