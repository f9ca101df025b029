"""Motion profiles: the fraction of the path σ as a function of the fraction of the duration η.

A profile consists of smooth pieces. Each returns its Taylor series at any point, so that derivatives of every order are exact.
To add a profile, write a class and add it to `PROFILES` with its name in scene files and its parameters.

Profiles without parameters are symmetric about the middle. Peaks of dσ/dη and d²σ/dη² are given as C_v and C_a: a motion of length L
in the time T has the peak velocity C_v L/T and the peak acceleration C_a L/T².

Source: R. L. Norton, *Cam Design and Manufacturing Handbook*, 2nd edition, Industrial Press 2009, chapters 2 to 4.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.curves import Side, checked_side
from flexfmu.trajectories.errors import TrajectoryError, within
from flexfmu.trajectories.jets import Jet, checked_order
from flexfmu.trajectories.polynomial_profile import PolynomialProfile
from flexfmu.trajectories.profile_pieces import Piece, ProfilePiece, SinePiece, SmoothPiece, joins, symmetric
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


EIGHTH = 0.125
"""Fraction of the duration in which the acceleration of the modified profiles rises."""


class FixedProfile:
    """A profile without parameters: two of a kind are equal. Without a dataclass, whose making takes longer than reading this file."""

    jumps: tuple[float, ...] = ()

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other)

    def __hash__(self) -> int:
        return hash(type(self))

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"


class FifthDegreePolynomial(FixedProfile):
    """Fifth-degree polynomial σ = 10 η³ - 15 η⁴ + 6 η⁵: velocity and acceleration are zero at both ends.

    C_v = 15/8, C_a = 10/√3 = 5.774; the jerk jumps by 60 at both ends.
    """

    pieces = symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)))


class SeventhDegreePolynomial(FixedProfile):
    """Seventh-degree polynomial σ = 35 η⁴ - 84 η⁵ + 70 η⁶ - 20 η⁷: velocity, acceleration and jerk are zero at both ends."""

    pieces = symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0)))


class BangBang(FixedProfile):
    """Bang-bang: d²σ/dη² = 4 in the first half, -4 in the second; the shortest motion for a given largest acceleration."""

    pieces = symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0, 0.0, 2.0)))
    jumps = (0.5,)


class Harmonic(FixedProfile):
    """Simple harmonic motion σ = (1 - cos πη) / 2; C_v = π/2, C_a = π²/2 = 4.935, by which it jumps at both ends."""

    pieces = symmetric(SinePiece(0.0, 0.5, 0.0, 0.5, math.pi, integrals=2))


class Cycloidal(FixedProfile):
    """Cycloidal motion σ = η - sin(2πη) / 2π: the acceleration is one period of a sine; C_v = 2, C_a = 2π = 6.283."""

    pieces = symmetric(SinePiece(0.0, 0.5, 0.0, 0.5 / math.pi, 2.0 * math.pi))


def _modified_sine() -> tuple[Piece, ...]:
    """The sine of frequency 4π in the first and the last eighth, that of 4π/3 between them."""
    unit = 1.0 / (4.0 + math.pi)
    rise = SinePiece(0.0, EIGHTH, 0.0, 0.25 * unit, 4.0 * math.pi)
    slow = 4.0 * math.pi / 3.0
    middle = SinePiece(EIGHTH, 1.0 - EIGHTH, 0.5, -2.25 * unit, slow, coefficients=(0.5, 4.0 * math.pi * unit))
    return symmetric(rise, middle=middle)


class ModifiedSine(FixedProfile):
    """Modified sine: the acceleration is a quarter of a fast sine, half a slow one, a quarter of a fast one.

    C_v = 4π/(4 + π) = 1.760, C_a = 4π²/(4 + π) = 5.528; the peak of their product, of which the inertial power follows, is 5.46.
    The fourth derivative jumps at the joins of the sines.
    """

    pieces = _modified_sine()
    jumps = joins(pieces)


def _modified_trapezoid() -> tuple[Piece, ...]:
    """Sine, parabola, half a sine about the middle, parabola, sine."""
    # acceleration A sin 4πη in the first eighth, and what it has led to at its end
    acceleration = 8.0 * math.pi / (2.0 + math.pi)
    amplitude = 0.5 / (math.pi * (2.0 + math.pi))
    rise = SinePiece(0.0, EIGHTH, 0.0, amplitude, 4.0 * math.pi)
    reached = amplitude * (0.5 * math.pi - 1.0), 2.0 / (2.0 + math.pi), 0.5 * acceleration
    plateau = ProfilePiece(EIGHTH, 3.0 * EIGHTH, EIGHTH, reached)
    # half a sine through zero
    flank = SinePiece(3.0 * EIGHTH, 5.0 * EIGHTH, 0.5, -amplitude, 4.0 * math.pi, coefficients=(0.5, 2.0))
    return symmetric(rise, plateau, middle=flank)


class ModifiedTrapezoid(FixedProfile):
    """Modified trapezoid: the acceleration is a trapezoid whose flanks are quarters of a sine.

    C_v = 2, C_a = 8π/(2 + π) = 4.888. The fourth derivative jumps at the ends of the flanks.
    """

    pieces = _modified_trapezoid()
    jumps = joins(pieces)


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
