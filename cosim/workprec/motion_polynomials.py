"""A planned joint motion as polynomials between its breakpoints, for solvers that ask for one time at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from flexfmu.trajectories.trajectory import Trajectory

Array = NDArray[np.float64]

DEGREE = 95
"""Of every polynomial: so high that the motions of the shipped scenes need no piece more than they have breakpoints, since solvers
of several steps start anew with each piece."""

ACCURACY = 1e-13
"""Largest error of an angle relative to its range; pieces are halved until they keep it."""

SMALLEST = 2.0**-12
"""Shortest piece, as a fraction of the interval between two breakpoints."""


@dataclass(frozen=True)
class Piece:
    """Joint angles over an interval of time.

    Attributes:
        begin, end: [s].
        coefficients: (3, DEGREE + 1, 2) Chebyshev coefficients of angles [rad], rates and accelerations on [-1, 1].
    """

    begin: float
    end: float
    coefficients: Array

    @property
    def numbers(self) -> Array:
        """begin, end and all coefficients in one vector, the last index running slowest."""
        return np.concatenate([[self.begin, self.end], self.coefficients.ravel(order="F")])


def pieces(motion: Trajectory, stop: float) -> tuple[Piece, ...]:
    """Polynomials that follow a joint motion, and its standstill afterwards, up to ``stop`` [s]."""
    points = [*motion.breakpoints, *([stop] if stop > motion.duration else [])]
    return tuple(piece for begin, end in pairwise(points) for piece in _split(motion, begin, end, end - begin))


def _split(motion: Trajectory, begin: float, end: float, whole: float) -> Iterator[Piece]:
    piece, error = _fit(motion, begin, end)
    if error <= ACCURACY or end - begin <= SMALLEST * whole:
        yield piece
        return
    middle = 0.5 * (begin + end)
    yield from _split(motion, begin, middle, whole)
    yield from _split(motion, middle, end, whole)


def _fit(motion: Trajectory, begin: float, end: float) -> tuple[Piece, float]:
    """Interpolation in Chebyshev's points, and its error in between."""
    half, centre = 0.5 * (end - begin), 0.5 * (begin + end)
    nodes = chebyshev.chebpts1(DEGREE + 1)
    between = np.cos(np.linspace(0.0, np.pi, 3 * DEGREE))[1:-1]
    values = motion.evaluate(centre + half * np.concatenate([nodes, between]), 2)
    series = np.stack([chebyshev.chebfit(nodes, each[: DEGREE + 1], DEGREE) for each in values])
    error = np.abs(chebyshev.chebval(between, series[0]).T - values[0, DEGREE + 1 :]).max()
    return Piece(begin, end, series), float(error / max(1.0, np.ptp(values[0])))
