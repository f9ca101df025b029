"""Arc length of a smooth curve, and its inverse to machine precision.

The parameter's interval is halved into panels until Legendre polynomials resolve the speed ds/du on each to rounding; the
arc length is the integral of that expansion. Newton's method on the series inverts it for many arc lengths at once. Adaptive
quadrature with a bracketing root finder (scipy's `quad` and `brentq`) agrees to rounding and takes 10⁵ times as long.

Source: L. N. Trefethen, *Approximation Theory and Approximation Practice*, SIAM 2013, chapters 8 (coefficients decay
geometrically for analytic functions) and 19 (quadrature).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

NODES = 20
"""Legendre polynomials per panel: a panel that they don't resolve is halved."""

TAIL = 1e-14
"""Size of the last two Legendre coefficients, relative to the largest, at which a panel counts as resolved: just above
their rounding errors. Integration divides them by about 2 NODES, so that they matter less than the length's rounding."""

ROUNDING = 1e-15
"""Rounding error of the speed relative to its largest value on the curve; elongated curves have parts where the speed
is small, and known no better than this."""

MOST_PANELS = 512
"""Far more panels than a blend needs: 7 where e = d, 16 where e = 10⁶ d."""

GUESSES_PER_PANEL = 32
"""Points on each panel through which the first guess of the inverse goes: good to about 1e-9, so that one of Newton's steps
is enough."""

CLOSE = 1e-8
"""Newton's last step in a panel's own variable, -1 to 1: convergence is quadratic, the error left is of the order of its
square."""

_POINTS, _WEIGHTS = legendre.leggauss(NODES)
_PROJECTION = (np.arange(NODES)[:, None] + 0.5) * legendre.legvander(_POINTS, NODES - 1).T * _WEIGHTS
"""From values at the points to Legendre coefficients, (2k + 1)/2 Σ w P_k f."""


@dataclass(frozen=True, eq=False)
class ArcLengthTable:
    """The arc length s(u) of a curve with the parameter u, as Legendre series on panels.

    Built once per curve by `tabulate`; the series are the integrals of the speed's expansions, which are resolved to
    rounding, so that evaluating them is a quadrature of full precision.

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
    guess: CubicHermiteSpline

    @property
    def length(self) -> float:
        """Length of the whole curve [m]."""
        return float(self.starts[-1])

    @cached_property
    def _series(self) -> RealArray:
        """Both series, shape (NODES + 1, 2, P)."""
        return np.stack([self.lengths, np.pad(self.speeds, ((0, 1), (0, 0)))], axis=1)

    def parameter(self, s: RealArray) -> RealArray:
        """The parameter u at the arc lengths s [m], shape (N,), by Newton's method; s is limited to the curve."""
        # the panel of each arc length, and its own variable ξ from -1 to 1
        s = np.clip(s, 0.0, self.length)
        panel = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, len(self.edges) - 2)
        low, high = self.edges[panel], self.edges[panel + 1]
        half = 0.5 * (high - low)
        series, target = self._series[:, :, panel], s - self.starts[panel]
        # Newton's method for all of them together; one step mostly does
        xi = np.clip((self.guess(s) - low) / half - 1.0, -1.0, 1.0)
        for _ in range(5):
            length, speed = legendre.legval(xi, series, tensor=False)
            step = (length - target) / (half * speed)
            xi = np.clip(xi - step, -1.0, 1.0)
            if np.all(np.abs(step) <= CLOSE):
                break
        return np.asarray(low + half * (xi + 1.0))


def tabulate(speed: Callable[[RealArray], RealArray], end: float) -> ArcLengthTable:
    """The arc length of a curve with ``speed`` ds/du [m] above zero for the parameter from 0 to ``end``.

    Raises:
        TrajectoryError: the curve is too elongated to be resolved.
    """
    edges = _panels(speed, end)
    # the speed's series on every panel, integrated from the panel's start
    speeds = np.stack([_expansion(speed, a, b) for a, b in pairwise(edges)], axis=1)
    lengths = legendre.legint(speeds, lbnd=-1.0) * (0.5 * np.diff(edges))
    starts = np.concatenate([[0.0], np.cumsum(lengths.sum(axis=0))])  # every Legendre polynomial is 1 at the end
    from scipy.interpolate import CubicHermiteSpline  # here, since reading a scene needs no scipy

    # a piecewise cubic u(s) through points on every panel, with exact slopes, as the first guess of the inverse
    xi = np.linspace(-1.0, 1.0, GUESSES_PER_PANEL, endpoint=False)
    u = edges[:-1, None] + 0.5 * np.diff(edges)[:, None] * (xi + 1.0)
    s = starts[:-1, None] + legendre.legval(xi, lengths)
    slope = 1.0 / legendre.legval(xi, speeds)
    last = 1.0 / speeds[:, -1].sum()
    guess = CubicHermiteSpline(np.append(s, starts[-1]), np.append(u, edges[-1]), np.append(slope, last))
    return ArcLengthTable(edges, starts, speeds, lengths, guess)


def _panels(speed: Callable[[RealArray], RealArray], end: float) -> RealArray:
    """Edges of panels on each of which the speed is resolved, found by halving."""
    # panels are resolved from left to right, so that their edges ascend
    waiting, edges = [(0.0, end)], [0.0]
    rounding = ROUNDING * float(np.max(speed(np.linspace(0.0, end, 8 * NODES))))
    while waiting:
        # the last coefficients tell whether the series has converged
        a, b = waiting.pop()
        size = np.abs(_expansion(speed, a, b))
        if np.sum(size[-2:]) <= max(TAIL * np.max(size), rounding):
            edges.append(b)
        else:
            waiting += [(0.5 * (a + b), b), (a, 0.5 * (a + b))]
        if len(waiting) + len(edges) > MOST_PANELS:
            raise TrajectoryError("a blend is too elongated for its arc length to be resolved; bring e/d nearer to 1")
    return np.array(edges)


def _expansion(speed: Callable[[RealArray], RealArray], a: float, b: float) -> RealArray:
    """Legendre coefficients of the speed between a and b, shape (NODES,), by Gauss quadrature."""
    return np.asarray(_PROJECTION @ speed(0.5 * (a + b) + 0.5 * (b - a) * _POINTS))
