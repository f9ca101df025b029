"""Plane curves by arc length: smooth pieces, and curves composed of them.

Derivatives by arc length come from series in the curve's parameter: the series of the speed is integrated to that of the arc
length and reverted, then the series of the coordinates are composed with it.

Arc length of a smooth curve, and its inverse to machine precision.

The parameter's interval is bisected into panels until a Legendre series represents the speed ds/du on each to rounding. The
arc length is the integral of that series. Newton's method inverts it, for many arc lengths at once. Adaptive quadrature with
a bracketing root finder (scipy's `quad` and `brentq`) agrees to rounding and takes 10⁵ times as long.

Source: L. N. Trefethen, *Approximation Theory and Approximation Practice*, SIAM 2013, chapters 8 (coefficients decay
geometrically for analytic functions) and 19 (quadrature).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal, Protocol, TypeAlias

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from flexfmu.trajectories.errors import TrajectoryError, within
from flexfmu.trajectories.jets import Jet, RealArray, checked_order, compose, revert, sqrt, stack, unstack

NODES = 20
"""Legendre coefficients per panel; a panel whose series has not converged with so many is bisected."""

TAIL = 1e-14
"""Sum of the last two Legendre coefficients, relative to the largest, below which a panel counts as resolved: just above their
rounding errors. Integration divides them by about 2 NODES, so that they contribute less than the rounding of the length."""

ROUNDING = 1e-15
"""Rounding error of the speed relative to its largest value on the curve. On elongated curves the speed is small in places, and
its absolute accuracy there is limited by this."""

MOST_PANELS = 512
"""Limit of the number of panels, far above what a blend needs: 7 for e = d, 16 for e = 10⁶ d."""

GUESSES_PER_PANEL = 32
"""Interpolation points per panel for the initial guess of the inverse; its error is about 1e-9, so that one Newton step is
enough."""

CLOSE = 1e-8
"""Newton step, in the panel's variable from -1 to 1, below which the iteration ends. Convergence is quadratic: the remaining error
is of the order of the step's square."""

_POINTS = legendre.leggauss(NODES)[0]
_PROJECTION = np.linalg.inv(legendre.legvander(_POINTS, NODES - 1))
"""(NODES, NODES) matrix from values at the Gauss points to Legendre coefficients. It equals c_k = (2k + 1)/2 Σ w P_k f, but NumPy's weights
w are 7e-14 off, with which `TAIL` is out of reach."""


def piecewise_cubic(x: RealArray, y: RealArray, slopes: RealArray) -> Callable[[RealArray], RealArray]:
    """Return the cubics through y with slopes dy/dx at ascending x, (K + 1,) each: scipy's `CubicHermiteSpline`, which loads slowly."""
    width = np.diff(x)
    chord = np.diff(y) / width
    bend = (slopes[:-1] + slopes[1:] - 2.0 * chord) / width
    coefficients = np.stack([y[:-1], slopes[:-1], (chord - slopes[:-1]) / width - bend, bend / width])

    return partial(_cubics, x, coefficients)


def _cubics(x: RealArray, coefficients: RealArray, at: RealArray) -> RealArray:
    """Cubics between ascending x, (K + 1,), with coefficients (4, K) of ascending powers, evaluated ``at`` places."""
    index = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    distance = at - x[index]
    c0, c1, c2, c3 = coefficients[:, index]
    square = distance * distance
    return np.asarray(c0 + c1 * distance + c2 * square + c3 * (square * distance))


@dataclass(frozen=True, eq=False)
class ArcLengthTable:
    """The arc length s(u) of a curve with the parameter u, as Legendre series on panels.

    `tabulate` builds it once per curve. The series are integrals of the speed's series, accurate to rounding.

    Attributes:
        edges: parameter at the panels' edges, shape (P + 1,).
        starts: arc length at the panels' edges [m], shape (P + 1,).
        speeds: Legendre coefficients of ds/du on each panel [m], shape (NODES, P).
        lengths: Legendre coefficients of s - starts on each panel [m], shape (NODES + 1, P).
        guess: interpolant u(s), from which Newton's method starts.
    """

    edges: RealArray
    starts: RealArray
    speeds: RealArray
    lengths: RealArray
    guess: Callable[[RealArray], RealArray]

    @property
    def length(self) -> float:
        """Length of the whole curve [m]."""
        return float(self.starts[-1])

    @cached_property
    def _series(self) -> RealArray:
        """Series of length and speed side by side, shape (NODES + 1, 2, P)."""
        return np.stack([self.lengths, np.pad(self.speeds, ((0, 1), (0, 0)))], axis=1)

    def parameter(self, s: RealArray) -> RealArray:
        """Return the parameter u at the arc lengths s [m], shape (N,), by Newton's method; s is clipped to the curve."""
        # the panel of each arc length, with its variable ξ from -1 to 1
        s = np.clip(s, 0.0, self.length)
        panel = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, len(self.edges) - 2)
        low, high = self.edges[panel], self.edges[panel + 1]
        half = 0.5 * (high - low)
        series, target = self._series[:, :, panel], s - self.starts[panel]
        # Newton's method for all points at once; one step is usually enough
        xi = np.clip((self.guess(s) - low) / half - 1.0, -1.0, 1.0)
        for _ in range(5):
            length, speed = legendre.legval(xi, series, tensor=False)
            step = (length - target) / (half * speed)
            xi = np.clip(xi - step, -1.0, 1.0)
            if np.all(np.abs(step) <= CLOSE):
                break
        return np.asarray(low + half * (xi + 1.0))


def tabulate(speed: Callable[[RealArray], RealArray], end: float) -> ArcLengthTable:
    """Return the arc length of a curve as a table.

    Args:
        speed: u (N,) → ds/du (N,) [m], positive.
        end: the parameter u runs from 0 to ``end``.

    Raises:
        TrajectoryError: the curve is so elongated that the series do not converge on `MOST_PANELS` panels.
    """
    edges, speeds = _panels(speed, end)
    # integrated from the panel's start
    lengths = legendre.legint(speeds, lbnd=-1.0) * (0.5 * np.diff(edges))
    starts = np.concatenate([[0.0], np.cumsum(lengths.sum(axis=0))])  # every Legendre polynomial is 1 at the end
    # a piecewise cubic u(s) through points on every panel, with exact slopes, as the first guess of the inverse
    xi = np.linspace(-1.0, 1.0, GUESSES_PER_PANEL, endpoint=False)
    u = edges[:-1, None] + 0.5 * np.diff(edges)[:, None] * (xi + 1.0)
    s = starts[:-1, None] + legendre.legval(xi, lengths)
    slope = 1.0 / legendre.legval(xi, speeds)
    last = 1.0 / speeds[:, -1].sum()
    guess = piecewise_cubic(np.append(s, starts[-1]), np.append(u, edges[-1]), np.append(slope, last))
    return ArcLengthTable(edges, starts, speeds, lengths, guess)


def _panels(speed: Callable[[RealArray], RealArray], end: float) -> tuple[RealArray, RealArray]:
    """Return the edges (P + 1,) of panels on which the series of the speed converges, found by bisection, and these series (NODES, P)."""
    # from left to right, so that the edges ascend
    waiting, edges, found = [(0.0, end)], [0.0], list[RealArray]()
    rounding = ROUNDING * float(np.max(speed(np.linspace(0.0, end, 8 * NODES))))
    while waiting:
        # small last coefficients: the series has converged
        a, b = waiting.pop()
        # by values at Gauss points
        series = np.asarray(_PROJECTION @ speed(0.5 * (a + b) + 0.5 * (b - a) * _POINTS))
        size = np.abs(series)
        if np.sum(size[-2:]) <= max(TAIL * np.max(size), rounding):
            edges.append(b)
            found.append(series)
        else:
            waiting += [(0.5 * (a + b), b), (a, 0.5 * (a + b))]
        if len(waiting) + len(edges) > MOST_PANELS:
            raise TrajectoryError("a blend is too elongated for its arc length to be resolved; bring e/d nearer to 1")
    return np.array(edges), np.stack(found, axis=1)


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

    def jets(self, s: RealArray, order: int) -> PlaneJets:
        """Return coordinates [m] and their derivatives by arc length at s (N,) [m], from 0 to the length."""


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
