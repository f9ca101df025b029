"""Motion profiles: the fraction of the path σ as a function of the fraction of the duration η.

A profile consists of smooth pieces. Each returns its Taylor series at any point, so that derivatives of every order are exact.
To add a profile, write a function and add it to `PROFILES` with its name in scene files and its parameters.

Profiles without parameters are symmetric about the middle. Peaks of dσ/dη and d²σ/dη² are given as C_v and C_a: a motion of length L
in the time T has the peak velocity C_v L/T and the peak acceleration C_a L/T².

Source: R. L. Norton, *Cam Design and Manufacturing Handbook*, 2nd edition, Industrial Press 2009, chapters 2 to 4.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.curves import Side, checked_side
from flexfmu.trajectories.errors import TrajectoryError, within
from flexfmu.trajectories.jets import Jet, RealArray, checked_order
from flexfmu.trajectories.roots import root_between

SMALL = 1.0
"""Angle [rad] below which u - sin u is summed as a series, since the difference loses digits."""

SERIES = tuple((-1.0) ** (k + 1) / math.factorial(2 * k + 1) for k in range(9, 0, -1))
"""Coefficients of u^19, u^17, ..., u³ in u - sin u; the next one is below rounding up to `SMALL`."""

EIGHTH = 0.125
"""Fraction of the duration in which the acceleration of the modified profiles rises."""

CLOSE = 1e-9
"""Largest error of σ(1) and dσ/dη(1): coefficients need ten digits where they aren't whole numbers."""

ROUNDING = 1e-9
"""Size of a coefficient of the speed, relative to the largest one, below which it is zero but for the given digits."""


class SmoothPiece(Protocol):
    """A smooth σ(η) for start ≤ η ≤ end, both fractions of the duration."""

    @property
    def start(self) -> float: ...

    @property
    def end(self) -> float: ...

    def jet(self, eta: RealArray, order: int) -> Jet:
        """σ and its derivatives by η at the fractions ``eta``, shape (N,)."""

    def value(self, eta: float) -> float:
        """σ at one fraction of the duration."""


@dataclass(frozen=True)
class Profile:
    """A piecewise smooth, monotonic σ(η) from σ(0) = 0 to σ(1) = 1, with zero velocity at both ends.

    Attributes:
        pieces: the pieces in ascending order; together they cover 0 to 1.
        jumps: fractions of the duration between 0 and 1, exclusive, at which the acceleration or a higher derivative jumps.
    """

    pieces: tuple[SmoothPiece, ...]
    jumps: tuple[float, ...] = ()


@dataclass(frozen=True)
class ProfilePiece:
    """A polynomial with a sinusoid for start ≤ η ≤ end: σ = Σ c_k x^k + amplitude · C_n(u), x = η - centre, u = frequency · x.

    C_2 = 1 - cos u and C_3 = u - sin u are integrals of the cosine from 0. So σ is exact relative to its own size also where
    it begins; rounding errors are smallest near ``centre``.

    Attributes:
        start, end: fractions of the duration.
        centre: fraction of the duration at which x = 0.
        coefficients: c_k, ascending; at least one.
        amplitude: factor of C_n; 0 for a polynomial alone.
        frequency: angular frequency by η [rad].
        integrals: n, 2 or 3.
    """

    start: float
    end: float
    centre: float
    coefficients: tuple[float, ...]
    amplitude: float = 0.0
    frequency: float = 0.0
    integrals: int = 3

    def jet(self, eta: RealArray, order: int) -> Jet:
        """σ and its derivatives by η at the fractions ``eta``, shape (N,)."""
        # powers of η - centre, times a matrix of binomial coefficients; added one by one, since NumPy sums a single column in an order of
        # its own on some processors
        powers = np.ones((len(self.coefficients), *eta.shape))
        powers[1:] = eta - self.centre
        np.multiply.accumulate(powers, axis=0, out=powers)
        series = np.add.accumulate(_shifted(self.coefficients, order)[:, :, None] * powers, axis=1)[:, -1]
        # each derivative undoes one integration of the cosine
        u = self.frequency * (eta - self.centre)
        for k in range(order + 1 if self.amplitude else 0):
            factor = self.amplitude * self.frequency**k / math.factorial(k)
            series[k] += factor * _integral_of_cosine(u, self.integrals - k)
        return Jet(series)

    def value(self, eta: float) -> float:
        """σ at one fraction of the duration."""
        # Horner's scheme
        result, x = 0.0, eta - self.centre
        for coefficient in reversed(self.coefficients):
            result = result * x + coefficient
        if not self.amplitude:
            return result
        u = self.frequency * x
        if self.integrals == 2:
            return result + self.amplitude * (2.0 * math.sin(0.5 * u) ** 2)
        return result + self.amplitude * (float(_series(np.float64(u))) if abs(u) <= SMALL else u - math.sin(u))

    def mirrored(self) -> ProfilePiece:
        """The point reflection 1 - σ(1 - η), expanded about 1 - centre."""
        # even coefficients change sign
        reflected = [-c * (-1.0) ** k for k, c in enumerate(self.coefficients)]
        reflected[0] += 1.0
        amplitude = self.amplitude * -((-1.0) ** self.integrals)
        ends = 1.0 - self.end, 1.0 - self.start, 1.0 - self.centre
        return ProfilePiece(*ends, tuple(reflected), amplitude, self.frequency, self.integrals)


@cache
def _shifted(coefficients: tuple[float, ...], order: int) -> RealArray:
    """Return the (order + 1, n) matrix from powers of x to the normalised Taylor coefficients of a polynomial at x."""
    # (x + t)^j has C(j, k) x^(j-k) as its coefficient of t^k
    matrix = np.zeros((order + 1, len(coefficients)))
    for j, coefficient in enumerate(coefficients):
        for k in range(min(order, j) + 1):
            matrix[k, j - k] = math.comb(j, k) * coefficient
    return matrix


def _integral_of_cosine(u: RealArray, times: int) -> RealArray:
    """Return the cosine integrated ``times`` times from 0, at most 3; a negative number differentiates it."""
    if times == 3:
        inside = np.clip(u, -SMALL, SMALL)
        return np.where(abs(u) <= SMALL, _series(inside), u - np.sin(u))
    if times == 2:
        return np.asarray(2.0 * np.sin(0.5 * u) ** 2)
    # sine, cosine, and then both with the other sign
    function: Callable[[RealArray], RealArray] = np.sin if times % 2 else np.cos
    return (1.0 if times % 4 in (0, 1) else -1.0) * function(u)


def _series(u: Any) -> Any:
    """Return u - sin u for small angles by its series."""
    result, square = 0.0 * u, u * u
    for coefficient in SERIES:
        result = result * square + coefficient
    return result * square * u


def symmetric(*half: ProfilePiece, middle: ProfilePiece | None = None, smooth: bool = False) -> Profile:
    """Return the profile of pieces from 0 up to the middle, then ``middle``, then the point reflections of the first ones.

    A derivative jumps wherever two pieces meet, unless the profile is ``smooth``.
    """
    back = (piece.mirrored() for piece in reversed(half))
    pieces = (*half, *(() if middle is None else (middle,)), *back)
    return Profile(pieces, () if smooth else tuple(piece.start for piece in pieces[1:]))


def fifth_degree_polynomial() -> Profile:
    """Fifth-degree polynomial σ = 10 η³ - 15 η⁴ + 6 η⁵: velocity and acceleration are zero at both ends.

    C_v = 15/8, C_a = 10/√3 = 5.774; the jerk jumps by 60 at both ends.
    """
    return symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)), smooth=True)


def seventh_degree_polynomial() -> Profile:
    """Seventh-degree polynomial σ = 35 η⁴ - 84 η⁵ + 70 η⁶ - 20 η⁷: velocity, acceleration and jerk are zero at both ends."""
    return symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0)), smooth=True)


def bang_bang() -> Profile:
    """Bang-bang: d²σ/dη² = 4 in the first half, -4 in the second; the shortest motion for a given largest acceleration."""
    return symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0, 0.0, 2.0)))


def harmonic() -> Profile:
    """Simple harmonic motion σ = (1 - cos πη) / 2; C_v = π/2, C_a = π²/2 = 4.935, by which it jumps at both ends."""
    return symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0,), 0.5, math.pi, integrals=2), smooth=True)


def cycloidal() -> Profile:
    """Cycloidal motion σ = η - sin(2πη) / 2π: the acceleration is one period of a sine; C_v = 2, C_a = 2π = 6.283."""
    return symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0,), 0.5 / math.pi, 2.0 * math.pi), smooth=True)


def modified_sine() -> Profile:
    """Modified sine: the acceleration is a quarter of a fast sine, half a slow one, a quarter of a fast one.

    C_v = 4π/(4 + π) = 1.760, C_a = 4π²/(4 + π) = 5.528; the peak of their product, of which the inertial power follows, is 5.46.
    The fourth derivative jumps at the joins of the sines.
    """
    # the sine of frequency 4π in the first and the last eighth, that of 4π/3 between them
    unit, fast = 1.0 / (4.0 + math.pi), 4.0 * math.pi
    rise = ProfilePiece(0.0, EIGHTH, 0.0, (0.0,), 0.25 * unit, fast)
    middle = ProfilePiece(EIGHTH, 1.0 - EIGHTH, 0.5, (0.5, fast * unit), -2.25 * unit, fast / 3.0)
    return symmetric(rise, middle=middle)


def modified_trapezoid() -> Profile:
    """Modified trapezoid: the acceleration is a trapezoid whose flanks are quarters of a sine.

    C_v = 2, C_a = 8π/(2 + π) = 4.888. The fourth derivative jumps at the ends of the flanks.
    """
    # acceleration A sin 4πη in the first eighth, and what it has led to at its end
    acceleration = 8.0 * math.pi / (2.0 + math.pi)
    amplitude = 0.5 / (math.pi * (2.0 + math.pi))
    rise = ProfilePiece(0.0, EIGHTH, 0.0, (0.0,), amplitude, 4.0 * math.pi)
    reached = amplitude * (0.5 * math.pi - 1.0), 2.0 / (2.0 + math.pi), 0.5 * acceleration
    plateau = ProfilePiece(EIGHTH, 3.0 * EIGHTH, EIGHTH, reached)
    # half a sine through zero
    flank = ProfilePiece(3.0 * EIGHTH, 5.0 * EIGHTH, 0.5, (0.5, 2.0), -amplitude, 4.0 * math.pi)
    return symmetric(rise, plateau, middle=flank)


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


def trapezoidal(ramp: float) -> Profile:
    """Trapezoidal velocity: constant acceleration, constant velocity 1/(1 - ramp), constant deceleration.

    Args:
        ramp: duration of each of the two ramps as a fraction of the whole duration, 0 < ramp ≤ 0.5.

    Raises:
        TrajectoryError: the ramp is out of range.
    """
    RAMP.check("ramp", ramp)
    # velocity from the area under it, which is 1; no straight line where the ramps fill the duration
    velocity = 1.0 / (1.0 - ramp)
    first = ProfilePiece(0.0, ramp, 0.0, (0.0, 0.0, 0.5 * velocity / ramp))
    middle = ProfilePiece(ramp, 1.0 - ramp, 0.5, (0.5, velocity))
    return symmetric(first, middle=middle if middle.start < middle.end else None)


def double_s(ramp: float, jerk_phase: float) -> Profile:
    """Double-S velocity: seven phases of constant jerk, so that the acceleration is a trapezoid in each ramp.

    Peak velocity 1/(1 - ramp), peak acceleration that velocity by ramp - jerk_phase, jerk that acceleration by jerk_phase.
    Source: L. Biagiotti, C. Melchiorri, *Trajectory Planning for Automatic Machines and Robots*, Springer 2008, chapter 3.

    Args:
        ramp: duration of each of the two ramps of the velocity as a fraction of the whole duration, 0 < ramp ≤ 0.5.
        jerk_phase: duration of each of the four phases of constant jerk as a fraction of the whole duration, at most ramp/2.

    Raises:
        TrajectoryError: a parameter is out of range, or the phases of a ramp don't fit into it.
    """
    RAMP.check("ramp", ramp)
    JERK_PHASE.check("jerk_phase", jerk_phase)
    if jerk_phase > 0.5 * ramp:
        raise TrajectoryError(
            f"jerk_phase must be at most half of ramp = {ramp:g}, which is {0.5 * ramp:g} of the duration, "
            f"got {jerk_phase:g}"
        )
    # velocity from the area under it, then acceleration and jerk
    velocity = 1.0 / (1.0 - ramp)
    acceleration = velocity / (ramp - jerk_phase)
    jerk = acceleration / jerk_phase
    # the ramp's phases, each about the end at which its coefficients are known; the second one unless it takes no time
    first = ProfilePiece(0.0, jerk_phase, 0.0, (0.0, 0.0, 0.0, jerk / 6.0))
    begin = jerk * jerk_phase**3 / 6.0, 0.5 * acceleration * jerk_phase, 0.5 * acceleration
    second = ProfilePiece(jerk_phase, ramp - jerk_phase, jerk_phase, begin)
    third = ProfilePiece(ramp - jerk_phase, ramp, ramp, (0.5 * velocity * ramp, velocity, 0.0, -jerk / 6.0))
    up = (first, second, third) if second.start < second.end else (first, replace(third, start=jerk_phase))
    middle = ProfilePiece(ramp, 1.0 - ramp, 0.5, (0.5, velocity))
    return symmetric(*up, middle=middle if middle.start < middle.end else None)


def polynomial(coefficients: Sequence[float]) -> Profile:
    """A polynomial σ(η) = Σ c_k η^k from 0 to 1 with zero velocity at both ends, which always moves forward between them.

    It is expanded about both ends, so that rounding errors are smallest there. What the given digits leave of σ(1) = 1 and
    dσ/dη(1) = 0 is removed by a cubic, so that the motion ends where it should.

    Args:
        coefficients: c_k by ascending powers; c_0 = c_1 = 0.

    Raises:
        TrajectoryError: a coefficient isn't finite, an end isn't at rest or isn't reached, or the motion stops or goes
            backwards on its way.
    """
    given = [float(c) for c in coefficients]
    named = f"the profile with coefficients {given}"
    if not all(map(math.isfinite, given)):
        raise TrajectoryError(f"{named} must have finite coefficients")
    if len(given) < 3 or given[0] != 0.0 or given[1] != 0.0:
        raise TrajectoryError(f"{named} must begin at rest: its first two coefficients must be 0, of ascending powers")
    value, slope = (_coefficient_at_end(given, k) for k in (0, 1))
    if abs(value - 1.0) > CLOSE:
        raise TrajectoryError(f"{named} must end at 1: its coefficients must have the sum 1, got {value:.8g}")
    if abs(slope) > CLOSE:
        raise TrajectoryError(f"{named} must end at rest: the sum of k c_k must be 0, got {slope:.4g}")
    # a cubic from rest to rest and one of the slope remove what the given digits leave at the end
    given += [0.0] * (4 - len(given))
    given[2] += 3.0 * (1.0 - value) + slope
    given[3] -= 2.0 * (1.0 - value) + slope
    last = [1.0, 0.0, *(_coefficient_at_end(given, k) for k in range(2, len(given)))]
    pieces = ProfilePiece(0.0, 0.5, 0.0, tuple(given)), ProfilePiece(0.5, 1.0, 1.0, tuple(last))
    # forward in both halves: the speed by the distance from the end, without its zeros there, is above zero
    for piece, direction in zip(pieces, (1.0, -1.0), strict=True):
        speed = np.array([k * c * direction ** (k - 1) for k, c in enumerate(piece.coefficients)][1:])
        begin = next(k for k, c in enumerate(speed) if abs(c) > ROUNDING * abs(speed).max())
        rest = np.polynomial.Polynomial(speed[begin:])
        # its smallest value is at an end of the half or where its slope is zero
        roots: list[complex] = rest.deriv().roots().astype(complex).tolist()
        inner = [root.real for root in roots if 0.0 < root.real < 0.5 and abs(root.imag) < ROUNDING]
        points = np.array([0.0, 0.5, *inner])
        values = rest(points)
        if values.min() <= 0.0:
            at = piece.centre + direction * float(points[values.argmin()])
            raise TrajectoryError(
                f"{named} stops or goes backwards at {at:.4g} of the duration; it must rise all the way"
            )
    return Profile(pieces)


def _coefficient_at_end(coefficients: Sequence[float], k: int) -> float:
    """Return the coefficient of (η - 1)^k from those of η^k."""
    return math.fsum(math.comb(j, k) * c for j, c in enumerate(coefficients))


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
    "poly7": ProfileKind("seventh-degree polynomial", seventh_degree_polynomial),
    "poly5": ProfileKind("fifth-degree polynomial", fifth_degree_polynomial),
    "bang-bang": ProfileKind("bang-bang", bang_bang),
    "trapezoidal": ProfileKind("trapezoidal", trapezoidal, {"ramp": RAMP}),
    "double-s": ProfileKind("double-S", double_s, {"ramp": RAMP, "jerk_phase": JERK_PHASE}),
    "harmonic": ProfileKind("harmonic", harmonic),
    "cycloidal": ProfileKind("cycloidal", cycloidal),
    "modified-sine": ProfileKind("modified sine", modified_sine),
    "modified-trapezoid": ProfileKind("modified trapezoid", modified_trapezoid),
    "polynomial": ProfileKind("polynomial", polynomial, {"coefficients": Coefficients(3)}),
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
