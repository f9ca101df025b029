"""Motion profiles: the fraction of the path σ as a function of the fraction of the duration η.

A profile consists of smooth pieces. Each returns its Taylor series at any point, so that derivatives of every order are exact.
To add a profile, write a class and add it to `PROFILES` with its name in scene files and its parameters.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.cam_profiles import (
    Cycloidal,
    FifthDegreePolynomial,
    Harmonic,
    ModifiedSine,
    ModifiedTrapezoid,
)
from flexfmu.trajectories.curves import Side, checked_side
from flexfmu.trajectories.errors import TrajectoryError, within
from flexfmu.trajectories.jets import Jet, checked_order
from flexfmu.trajectories.polynomial_profile import PolynomialProfile
from flexfmu.trajectories.profile_pieces import Piece, ProfilePiece, SmoothPiece, joins, symmetric
from flexfmu.trajectories.roots import root_between


class Profile(Protocol):
    """A piecewise smooth, monotonic σ(η) from σ(0) = 0 to σ(1) = 1, with zero velocity at both ends."""

    @property
    def pieces(self) -> tuple[SmoothPiece, ...]:
        """The pieces in ascending order; together they cover 0 to 1."""
        ...

    @property
    def jumps(self) -> tuple[float, ...]:
        """Fractions of the duration between 0 and 1, exclusive, at which the acceleration or a higher derivative jumps."""
        ...


@dataclass(frozen=True)
class SeventhDegreePolynomial:
    """Seventh-degree polynomial σ = 35 η⁴ - 84 η⁵ + 70 η⁶ - 20 η⁷: velocity, acceleration and jerk are zero at both ends."""

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The polynomial twice: expanded about 0 for the first half, about 1 for the second."""
        return symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0)))

    @property
    def jumps(self) -> tuple[float, ...]:
        """None."""
        return ()


@dataclass(frozen=True)
class BangBang:
    """Bang-bang: d²σ/dη² = 4 in the first half, -4 in the second; the shortest motion for a given largest acceleration."""

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Two parabolas."""
        return symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0, 0.0, 2.0)))

    @property
    def jumps(self) -> tuple[float, ...]:
        """The middle."""
        return (0.5,)


@dataclass(frozen=True)
class Parameter:
    """Range of a profile parameter: above < parameter ≤ at_most, as fractions of the duration."""

    above: float
    at_most: float

    def check(self, name: str, value: float) -> None:
        """Raise TrajectoryError for a value out of range or NaN."""
        if not self.above < value <= self.at_most:
            raise TrajectoryError(
                f"{name} must be above {self.above:g} and at most {self.at_most:g} of the duration, got {value:g}"
            )

    def expected(self, name: str) -> str:
        """What scene files need, for messages."""
        return f"{self.above:g} < {name} <= {self.at_most:g} (fraction of the duration)"


@dataclass(frozen=True)
class Coefficients:
    """The coefficients of a polynomial, any number from ``at_least``."""

    at_least: int

    def expected(self, name: str) -> str:
        """What scene files need, for messages."""
        return f"{name} = [0, 0, c2, c3, ...], of ascending powers of the fraction of the duration"


RAMP = Parameter(above=0.0, at_most=0.5)
"""Range of a ramp's duration; at 0.5 two ramps fill the whole duration."""

JERK_PHASE = Parameter(above=0.0, at_most=0.25)
"""Range of the duration of constant jerk; at 0.25 four of them fill the whole duration."""


@dataclass(frozen=True)
class Trapezoidal:
    """Trapezoidal velocity: constant acceleration, constant velocity 1/(1 - ramp), constant deceleration.

    Attributes:
        ramp: duration of each of the two ramps as a fraction of the whole duration, 0 < ramp ≤ 0.5.

    Raises:
        TrajectoryError: the ramp is out of range.
    """

    ramp: float

    def __post_init__(self) -> None:
        RAMP.check("ramp", self.ramp)

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Two parabolas, and a straight line between them unless the ramps fill the duration."""
        # velocity from the area under it, which is 1
        velocity = 1.0 / (1.0 - self.ramp)
        middle = ProfilePiece(self.ramp, 1.0 - self.ramp, 0.5, (0.5, velocity))
        first = ProfilePiece(0.0, self.ramp, 0.0, (0.0, 0.0, 0.5 * velocity / self.ramp))
        return symmetric(first, middle=middle if middle.start < middle.end else None)

    @property
    def jumps(self) -> tuple[float, ...]:
        """The ends of the ramps."""
        return tuple(sorted({self.ramp, 1.0 - self.ramp}))


@dataclass(frozen=True)
class DoubleS:
    """Double-S velocity: seven phases of constant jerk, so that the acceleration is a trapezoid in each ramp.

    Peak velocity 1/(1 - ramp), peak acceleration that velocity by ramp - jerk_phase, jerk that acceleration by jerk_phase.
    Source: L. Biagiotti, C. Melchiorri, *Trajectory Planning for Automatic Machines and Robots*, Springer 2008, chapter 3.

    Attributes:
        ramp: duration of each of the two ramps of the velocity as a fraction of the whole duration, 0 < ramp ≤ 0.5.
        jerk_phase: duration of each of the four phases of constant jerk as a fraction of the whole duration, at most ramp/2.

    Raises:
        TrajectoryError: a parameter is out of range, or the phases of a ramp don't fit into it.
    """

    ramp: float
    jerk_phase: float

    def __post_init__(self) -> None:
        RAMP.check("ramp", self.ramp)
        JERK_PHASE.check("jerk_phase", self.jerk_phase)
        if self.jerk_phase > 0.5 * self.ramp:
            raise TrajectoryError(
                f"jerk_phase must be at most half of ramp = {self.ramp:g}, which is {0.5 * self.ramp:g} of the duration, "
                f"got {self.jerk_phase:g}"
            )

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Cubic, parabola, cubic, straight line, and the same backwards; the second and the fourth unless they take no time."""
        # velocity from the area under it, then acceleration and jerk
        ramp, phase = self.ramp, self.jerk_phase
        velocity = 1.0 / (1.0 - ramp)
        acceleration = velocity / (ramp - phase)
        jerk = acceleration / phase
        # the ramp's phases, each about the end at which its coefficients are known
        first = ProfilePiece(0.0, phase, 0.0, (0.0, 0.0, 0.0, jerk / 6.0))
        begin = jerk * phase**3 / 6.0, 0.5 * acceleration * phase, 0.5 * acceleration
        second = ProfilePiece(phase, ramp - phase, phase, begin)
        third = ProfilePiece(ramp - phase, ramp, ramp, (0.5 * velocity * ramp, velocity, 0.0, -jerk / 6.0))
        up = (first, second, third) if second.start < second.end else (first, replace(third, start=phase))
        middle = ProfilePiece(ramp, 1.0 - ramp, 0.5, (0.5, velocity))
        return symmetric(*up, middle=middle if middle.start < middle.end else None)

    @property
    def jumps(self) -> tuple[float, ...]:
        """The ends of the phases, where the jerk jumps."""
        return joins(self.pieces)


@dataclass(frozen=True)
class ProfileKind:
    """A kind of profile that scene files can name.

    Attributes:
        label: name in the report.
        make: parameters as keyword arguments → profile.
        parameters: name in the scene file → range; a name has the same range in all kinds.
    """

    label: str
    make: Callable[..., Profile]
    parameters: Mapping[str, Parameter | Coefficients] = field(default_factory=dict)


PROFILES: Mapping[str, ProfileKind] = {
    "poly7": ProfileKind("seventh-degree polynomial", SeventhDegreePolynomial),
    "poly5": ProfileKind("fifth-degree polynomial", FifthDegreePolynomial),
    "bang-bang": ProfileKind("bang-bang", BangBang),
    "trapezoidal": ProfileKind("trapezoidal", Trapezoidal, {"ramp": RAMP}),
    "double-s": ProfileKind("double-S", DoubleS, {"ramp": RAMP, "jerk_phase": JERK_PHASE}),
    "harmonic": ProfileKind("harmonic", Harmonic),
    "cycloidal": ProfileKind("cycloidal", Cycloidal),
    "modified-sine": ProfileKind("modified sine", ModifiedSine),
    "modified-trapezoid": ProfileKind("modified trapezoid", ModifiedTrapezoid),
    "polynomial": ProfileKind("polynomial", PolynomialProfile, {"coefficients": Coefficients(3)}),
}
"""Name in the scene file → kind of profile."""


def evaluate_profile(profile: Profile, eta: ArrayLike, order: int = 2, side: Side = "right") -> Jet:
    """Return σ and its derivatives by η as a jet of shape (N,).

    Args:
        profile: the motion profile.
        eta: fractions of the duration, 0 to 1, a number or shape (N,).
        order: order of the highest derivative, any.
        side: the one-sided limit where pieces meet.

    Raises:
        TrajectoryError: a fraction is out of range, the order is negative, or ``side`` is unknown.
    """
    eta, order = within("fraction of the duration", eta, 1.0, "(the whole)"), checked_order(order)
    # each piece at all of its fractions at once
    index = np.searchsorted([piece.start for piece in profile.pieces[1:]], eta, side=checked_side(side))
    coefficients = np.empty((order + 1, len(eta)))
    for i in np.flatnonzero(np.bincount(index)):
        coefficients[:, index == i] = profile.pieces[i].jet(eta[index == i], order).coefficients
    return Jet(coefficients)


def time_at(profile: Profile, fraction: float) -> float:
    """Return the fraction of the duration η at which σ(η) = ``fraction``, 0 < ``fraction`` < 1."""
    # one root, since a profile is monotonic
    pieces = profile.pieces
    starts = [piece.start for piece in pieces[1:]]

    def excess(eta: float) -> float:
        return pieces[bisect_right(starts, eta)].value(eta) - fraction

    eta = root_between(excess, 0.0, 1.0, absolute=1e-17)
    # one Newton step, since Brent's method stops within a few roundings of the root
    value, slope = evaluate_profile(profile, eta, 1).derivatives()[:, 0]
    return eta - float((value - fraction) / slope)
