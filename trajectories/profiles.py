"""Motion profiles: the fraction of the path σ as a function of the fraction of the duration η.

A profile consists of smooth pieces. Each returns its Taylor series at any point, so that derivatives of every order are exact.
To add a profile, write a class and add it to `PROFILES` with its name in scene files and its parameters.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.curves import Side, checked_side
from flexfmu.trajectories.errors import TrajectoryError, within
from flexfmu.trajectories.jets import Jet, RealArray, checked_order
from flexfmu.trajectories.roots import root_between


class SmoothPiece(Protocol):
    """A smooth σ(η) for start ≤ η ≤ end, both fractions of the duration."""

    @property
    def start(self) -> float: ...

    @property
    def end(self) -> float: ...

    def jet(self, eta: RealArray, order: int) -> Jet:
        """σ and its derivatives by η at the fractions ``eta``, shape (N,)."""
        ...

    def value(self, eta: float) -> float:
        """σ at one fraction of the duration."""
        ...


@dataclass(frozen=True)
class ProfilePiece:
    """A polynomial σ(η) for start ≤ η ≤ end in powers of η - centre; rounding errors are smallest near ``centre``.

    Attributes:
        start, end: fractions of the duration.
        centre: fraction of the duration about which the polynomial is expanded.
        coefficients: of (η - centre)^k, ascending.
    """

    start: float
    end: float
    centre: float
    coefficients: tuple[float, ...]

    def jet(self, eta: RealArray, order: int) -> Jet:
        """σ and its derivatives by η at the fractions ``eta``, shape (N,)."""
        # powers of η - centre, times a matrix of binomial coefficients
        powers = np.ones((len(self.coefficients), *eta.shape))
        powers[1:] = eta - self.centre
        np.multiply.accumulate(powers, axis=0, out=powers)
        return Jet((_shifted(self.coefficients, order)[:, :, None] * powers).sum(axis=1))

    def value(self, eta: float) -> float:
        """σ at one fraction of the duration."""
        # Horner's scheme
        result, x = 0.0, eta - self.centre
        for coefficient in reversed(self.coefficients):
            result = result * x + coefficient
        return result


class Profile(Protocol):
    """A piecewise smooth, monotonic σ(η) from σ(0) = 0 to σ(1) = 1, with zero velocity at both ends."""

    @property
    def pieces(self) -> tuple[SmoothPiece, ...]:
        """The pieces in ascending order; together they cover 0 to 1."""
        ...

    @property
    def jumps(self) -> tuple[float, ...]:
        """Fractions of the duration between 0 and 1, exclusive, at which the acceleration jumps."""
        ...


@dataclass(frozen=True)
class SeventhDegreePolynomial:
    """Seventh-degree polynomial σ = 35 η⁴ - 84 η⁵ + 70 η⁶ - 20 η⁷: velocity, acceleration and jerk are zero at both ends."""

    @property
    def pieces(self) -> tuple[ProfilePiece, ...]:
        """The polynomial twice: expanded about 0 for the first half, about 1 for the second."""
        return _symmetric((0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0), 0.5)

    @property
    def jumps(self) -> tuple[float, ...]:
        """None."""
        return ()


@dataclass(frozen=True)
class BangBang:
    """Bang-bang: d²σ/dη² = 4 in the first half, -4 in the second; the shortest motion for a given largest acceleration."""

    @property
    def pieces(self) -> tuple[ProfilePiece, ...]:
        """Two parabolas."""
        return _symmetric((0.0, 0.0, 2.0), 0.5)

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


RAMP = Parameter(above=0.0, at_most=0.5)
"""Range of a ramp's duration; at 0.5 two ramps fill the whole duration."""


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
    def pieces(self) -> tuple[ProfilePiece, ...]:
        """Two parabolas, and a straight line between them unless the ramps fill the duration."""
        # velocity from the area under it, which is 1
        velocity = 1.0 / (1.0 - self.ramp)
        first, last = _symmetric((0.0, 0.0, 0.5 * velocity / self.ramp), self.ramp)
        middle = ProfilePiece(self.ramp, 1.0 - self.ramp, 0.5, (0.5, velocity))
        return (first, middle, last) if middle.start < middle.end else (first, last)

    @property
    def jumps(self) -> tuple[float, ...]:
        """The ends of the ramps."""
        return tuple(sorted({self.ramp, 1.0 - self.ramp}))


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
    parameters: Mapping[str, Parameter] = field(default_factory=dict)


PROFILES: Mapping[str, ProfileKind] = {
    "poly7": ProfileKind("seventh-degree polynomial", SeventhDegreePolynomial),
    "bang-bang": ProfileKind("bang-bang", BangBang),
    "trapezoidal": ProfileKind("trapezoidal", Trapezoidal, {"ramp": RAMP}),
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


@cache
def _shifted(coefficients: tuple[float, ...], order: int) -> RealArray:
    """Return the (order + 1, n) matrix from powers of x to the normalised Taylor coefficients of a polynomial at x."""
    # (x + t)^j has C(j, k) x^(j-k) as its coefficient of t^k
    matrix = np.zeros((order + 1, len(coefficients)))
    for j, coefficient in enumerate(coefficients):
        for k in range(min(order, j) + 1):
            matrix[k, j - k] = math.comb(j, k) * coefficient
    return matrix


def _symmetric(coefficients: tuple[float, ...], end: float) -> tuple[ProfilePiece, ProfilePiece]:
    """Return a piece from 0 to ``end`` expanded about 0, and its point reflection 1 - σ(1 - η), expanded about 1."""
    # in powers of η - 1, even coefficients change sign
    reflected = [-c * (-1.0) ** k for k, c in enumerate(coefficients)]
    reflected[0] += 1.0
    return ProfilePiece(0.0, end, 0.0, coefficients), ProfilePiece(1.0 - end, 1.0, 1.0, tuple(reflected))
