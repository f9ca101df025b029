"""Smooth pieces of motion profiles: polynomials, and polynomials with a sinusoid. Their Taylor series are exact to any order."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol, TypeAlias

import numpy as np

from flexfmu.trajectories.jets import Jet, RealArray

SMALL = 1.0
"""Angle [rad] below which u - sin u is summed as a series, since the difference loses digits."""

SERIES = tuple((-1.0) ** (k + 1) / math.factorial(2 * k + 1) for k in range(9, 0, -1))
"""Coefficients of u^19, u^17, ..., u³ in u - sin u; the next one is below rounding up to `SMALL`."""


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

    def mirrored(self) -> ProfilePiece:
        """The point reflection 1 - σ(1 - η), expanded about 1 - centre."""
        return ProfilePiece(1.0 - self.end, 1.0 - self.start, 1.0 - self.centre, _reflected(self.coefficients))


@dataclass(frozen=True)
class SinePiece:
    """A polynomial with a sinusoid for start ≤ η ≤ end: σ = Σ c_k x^k + amplitude · C_n(u), x = η - centre, u = frequency · x.

    C_2 = 1 - cos u and C_3 = u - sin u are integrals of the cosine from 0. So σ is exact relative to its own size also where
    it begins.

    Attributes:
        start, end: fractions of the duration.
        centre: fraction of the duration at which x = 0.
        amplitude: factor of C_n.
        frequency: angular frequency by η [rad].
        integrals: n, 2 or 3.
        coefficients: c_k, ascending; at least one.
    """

    start: float
    end: float
    centre: float
    amplitude: float
    frequency: float
    integrals: int = 3
    coefficients: tuple[float, ...] = (0.0,)

    def jet(self, eta: RealArray, order: int) -> Jet:
        """σ and its derivatives by η at the fractions ``eta``, shape (N,)."""
        result = ProfilePiece(self.start, self.end, self.centre, self.coefficients).jet(eta, order)
        # each derivative undoes one integration of the cosine
        u = self.frequency * (eta - self.centre)
        for k in range(order + 1):
            factor = self.amplitude * self.frequency**k / math.factorial(k)
            result.coefficients[k] += factor * _integral_of_cosine(u, self.integrals - k)
        return result

    def value(self, eta: float) -> float:
        """σ at one fraction of the duration."""
        rest = ProfilePiece(self.start, self.end, self.centre, self.coefficients).value(eta)
        u = self.frequency * (eta - self.centre)
        return rest + self.amplitude * (_angle_minus_sine(u) if self.integrals == 3 else 2.0 * math.sin(0.5 * u) ** 2)

    def mirrored(self) -> SinePiece:
        """The point reflection 1 - σ(1 - η), about 1 - centre."""
        amplitude = self.amplitude * -((-1.0) ** self.integrals)
        ends = 1.0 - self.end, 1.0 - self.start, 1.0 - self.centre
        return SinePiece(*ends, amplitude, self.frequency, self.integrals, _reflected(self.coefficients))


Piece: TypeAlias = ProfilePiece | SinePiece


def symmetric(*half: Piece, middle: Piece | None = None) -> tuple[Piece, ...]:
    """Return pieces from 0 up to the middle, then ``middle``, then the point reflections of the first ones."""
    back = (piece.mirrored() for piece in reversed(half))
    return (*half, *(() if middle is None else (middle,)), *back)


def joins(pieces: tuple[SmoothPiece, ...]) -> tuple[float, ...]:
    """Return the fractions at which pieces meet."""
    return tuple(piece.start for piece in pieces[1:])


@cache
def _shifted(coefficients: tuple[float, ...], order: int) -> RealArray:
    """Return the (order + 1, n) matrix from powers of x to the normalised Taylor coefficients of a polynomial at x."""
    # (x + t)^j has C(j, k) x^(j-k) as its coefficient of t^k
    matrix = np.zeros((order + 1, len(coefficients)))
    for j, coefficient in enumerate(coefficients):
        for k in range(min(order, j) + 1):
            matrix[k, j - k] = math.comb(j, k) * coefficient
    return matrix


def _reflected(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """Return the coefficients of 1 - P(-x)."""
    # even coefficients change sign
    reflected = [-c * (-1.0) ** k for k, c in enumerate(coefficients)]
    reflected[0] += 1.0
    return tuple(reflected)


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


def _angle_minus_sine(u: float) -> float:
    """Return u - sin u, exact relative to its own size."""
    return float(_series(np.float64(u))) if abs(u) <= SMALL else u - math.sin(u)


def _series(u: Any) -> Any:
    """Return u - sin u for small angles by its series."""
    result, square = 0.0 * u, u * u
    for coefficient in SERIES:
        result = result * square + coefficient
    return result * square * u
