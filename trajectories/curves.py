"""Plane curves by arc length: smooth pieces, and curves composed of them.

Derivatives by arc length come from series in the curve's parameter: the series of the speed is integrated to that of the arc
length and reverted, then the series of the coordinates are composed with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.arc_length import ArcLengthTable, tabulate
from flexfmu.trajectories.errors import TrajectoryError, within
from flexfmu.trajectories.jets import Jet, RealArray, checked_order, compose, revert, sqrt, stack, unstack

Side: TypeAlias = Literal["left", "right"]
"""Which one-sided limit to take where a derivative jumps."""

PlaneJets: TypeAlias = tuple[Jet, Jet]
"""Coordinates of points as two jets of the same order and shape."""

Point: TypeAlias = tuple[float, float]


class Piece(Protocol):
    """A smooth curve, with one-sided derivatives of every order at its ends."""

    @property
    def length(self) -> float:
        """Length [m]."""
        ...

    def jets(self, s: RealArray, order: int) -> PlaneJets:
        """Return coordinates [m] and their derivatives by arc length at s (N,) [m], from 0 to the length."""
        ...


@dataclass(frozen=True)
class StraightLine:
    """A straight line from the origin along the second axis (the lift)."""

    length: float

    def jets(self, s: RealArray, order: int) -> PlaneJets:
        """See `Piece`."""
        return Jet.constant(np.zeros_like(s), order), Jet.variable(s, order)


@dataclass(frozen=True, eq=False)
class ParametricPiece:
    """A smooth curve with a regular parametrisation, evaluated by arc length.

    Attributes:
        curve: jet of the parameter → jets of the coordinates [m].
        end: the parameter runs from 0 to ``end``.
    """

    curve: Callable[[Jet], PlaneJets]
    end: float

    @cached_property
    def table(self) -> ArcLengthTable:
        """Arc length as a function of the parameter."""

        def speed(u: RealArray) -> RealArray:
            x, y = self.curve(Jet.variable(u, 1))
            return np.asarray(np.hypot(x.coefficients[1], y.coefficients[1]))

        return tabulate(speed, self.end)

    @property
    def length(self) -> float:
        """Length [m]."""
        return self.table.length

    def jets(self, s: RealArray, order: int) -> PlaneJets:
        """See `Piece`. The parameter's series in s is the reversion of the arc length's series in the parameter."""
        u = self.table.parameter(s)
        if order == 0:
            return self.curve(Jet.variable(u, 0))
        # ds/du = |(x', y')|
        x, y = self.curve(Jet.variable(u, order))
        point = stack((x, y))
        slope = point.differentiate()
        squares = unstack(slope * slope)
        arc = sqrt(squares[0] + squares[1]).integrate()
        return unstack(compose(point, revert(arc)))


@dataclass(frozen=True, eq=False)
class PlacedPiece:
    """A piece placed in the plane, and traversed backwards if ``backwards``.

    Attributes:
        piece: the piece in its own axes.
        origin: position of the piece's origin [m].
        first, second: directions of the piece's axes, unit vectors.
        backwards: whether arc length counts from the end of ``piece``.
    """

    piece: Piece
    origin: Point
    first: Point
    second: Point
    backwards: bool = False

    @property
    def length(self) -> float:
        """Length [m]."""
        return self.piece.length

    def jets(self, s: RealArray, order: int) -> PlaneJets:
        """See `Piece`."""
        # traversed backwards, derivatives of odd order change sign
        own = self.own_arc_length(Jet.variable(s, order))
        u, v = self.piece.jets(own.value, order)
        return self.moved((u.rescale(-1.0), v.rescale(-1.0)) if self.backwards else (u, v))

    def own_arc_length(self, s: Jet) -> Jet:
        """Return the arc length counted in the direction of ``piece`` [m]."""
        return self.length - s if self.backwards else s

    def moved(self, point: PlaneJets) -> PlaneJets:
        """Transform points from the axes of ``piece`` to the plane [m]."""
        u, v = point
        x, y = (u * self.first[i] + v * self.second[i] + self.origin[i] for i in (0, 1))
        return x, y

    def placed(self, coefficients: RealArray) -> RealArray:
        """Transform series of points (order + 1, 2, N) from the axes of ``piece`` to the plane, (order + 1, N, 2)."""
        u, v = coefficients[:, 0, :, np.newaxis], coefficients[:, 1, :, np.newaxis]
        result: RealArray = u * self.first + v * self.second
        result[0] += self.origin
        return result


@dataclass(frozen=True)
class PiecewiseCurve:
    """A sequence of smooth pieces, continuous in position.

    Attributes:
        pieces: at least one; each begins at the end point of the one before.
    """

    pieces: tuple[Piece, ...]

    @cached_property
    def edges(self) -> RealArray:
        """Arc lengths [m] at the ends of the pieces, from 0 to the length, shape (pieces + 1,)."""
        return np.concatenate([[0.0], np.cumsum([piece.length for piece in self.pieces])])

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(self.edges[-1])

    @property
    def knots(self) -> tuple[float, ...]:
        """Arc lengths [m] at which one piece ends and the next begins."""
        return tuple(self.edges[1:-1].tolist())

    def jets(self, s: ArrayLike, order: int = 2, side: Side = "right") -> PlaneJets:
        """Return coordinates [m] and their derivatives by arc length, as jets of shape (N,).

        Args:
            s: arc length [m] from 0 to the length, a number or shape (N,).
            order: order of the highest derivative, any.
            side: the one-sided limit at knots.

        Raises:
            TrajectoryError: s is not between 0 and the length, the order is negative, or ``side`` is unknown.
        """
        s, order = within("arc length", s, self.length, "m"), checked_order(order)
        index = np.searchsorted(np.asarray(self.knots), s, side=checked_side(side))
        # each piece for all points on it at once
        result = np.empty((2, order + 1, len(s)))
        for i in np.flatnonzero(np.bincount(index)):
            here = index == i
            for row, jet in zip(result, self.pieces[i].jets(s[here] - self.edges[i], order), strict=True):
                row[:, here] = jet.coefficients
        return Jet(result[0]), Jet(result[1])


def checked_side(side: Side) -> Side:
    """Return ``side``; raise TrajectoryError if it is neither "left" nor "right"."""
    if side not in ("left", "right"):
        raise TrajectoryError(f'side must be "left" or "right", got {side!r}')
    return side
