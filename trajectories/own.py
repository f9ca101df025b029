"""Own motions: positions that a user's class gives, as trajectories with derivatives.

The positions become polynomials of degree 10 in time, on intervals that are halved until every other sample predicts those between
them. The samples are at Chebyshev points, where interpolation is nearly optimal.

Source: L. N. Trefethen, *Approximation Theory and Approximation Practice*, SIAM 2013, chapters 2 to 8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import comb
from typing import Any, Protocol, cast

import numpy as np
from numpy.polynomial import chebyshev

from flexfmu.trajectories.errors import TrajectoryError, positive
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import PiecewisePolynomial
from flexfmu.trajectories.trajectory import SAME_TIME, Trajectory

DEGREE = 10
"""Degree of the polynomials."""

NODES = -np.cos(np.pi * np.arange(17) / 16)
"""Chebyshev points, from -1 to 1; every other one predicts the rest."""

ACCURACY = 1e-12
"""Largest error of predicted samples relative to the motion's extent; that of the polynomials, through all samples, is below rounding."""

ROUNDING = 16 * np.finfo(float).eps
"""Rounding errors of predicted samples, relative to the largest position; in small motions they exceed `ACCURACY`."""

SHORTEST = 1e-4
"""Half of the shortest interval as a fraction of the duration; what needs a shorter one isn't smooth."""

SAMPLES = 200
"""Samples for the motion's extent."""

AT_REST = 1e-6
"""Velocity relative to the largest one, below which the motion is at rest at its ends and does not jump at breakpoints."""


_COARSE = chebyshev.chebvander(NODES, len(NODES) // 2)
PREDICTION = _COARSE @ np.linalg.inv(_COARSE[::2])
"""Matrix from values at every other node to those of their polynomial at all nodes."""

CHEBYSHEV = np.linalg.inv(chebyshev.chebvander(NODES, len(NODES) - 1))[: DEGREE + 1]
"""Matrix from values at the nodes to Chebyshev coefficients up to `DEGREE`; higher ones hold rounding errors."""

_POWERS = np.array([np.pad(chebyshev.cheb2poly(row), (0, DEGREE - k)) for k, row in enumerate(np.eye(DEGREE + 1))])
_SHIFT = [[comb(j, k) * (-1.0) ** (j - k) for j in range(DEGREE + 1)] for k in range(DEGREE + 1)]
TAYLOR = np.array(_SHIFT) @ _POWERS.T
"""Matrix from Chebyshev coefficients to Taylor coefficients about -1, powers of x = u - 1 in powers of u; whole numbers."""


class OwnMotion(Protocol):
    """What a user's class has to offer.

    It may also have ``breakpoints``, the instants within the motion [s] at which its acceleration or a higher derivative jumps, and
    ``coordinates``, "end-effector" (the default) or "joints".
    """

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        ...

    def position(self, time: float) -> Sequence[float]:
        """Return x and y of the end effector [m], or q11 and q21 of the joints [rad], at a time from 0 to the duration [s]."""
        ...


def as_trajectory(motion: OwnMotion | Trajectory) -> Trajectory:
    """Return a motion as a trajectory: itself if it has the members of `Trajectory`, otherwise polynomials through its positions.

    Raises:
        TrajectoryError: something is missing, a position is not two finite numbers, the motion doesn't begin and end at rest, its
            velocity jumps, or it isn't smooth between its breakpoints.
    """
    if isinstance(motion, type):
        raise TrajectoryError(
            f"an own motion is an object of its class: give {motion.__name__}() in place of {motion.__name__}"
        )
    if all(hasattr(motion, name) for name in ("duration", "breakpoints", "evaluate")):
        return cast(Trajectory, motion)
    for name in ("duration", "position"):
        if not hasattr(motion, name):
            raise TrajectoryError(
                f"{type(motion).__name__} has no `{name}`: an own motion needs `duration` [s] and `position(time)`"
            )
    # duration and breakpoints
    given: Any = motion.duration
    duration = positive("duration of the own motion", given() if callable(given) else given, "s")
    inner = sorted(float(point) for point in getattr(motion, "breakpoints", ()))
    points = (0.0, *(point for point in inner if SAME_TIME < point / duration < 1.0 - SAME_TIME), duration)
    # positions at many instants, one by one
    place = cast(OwnMotion, motion).position

    def sampled(at: RealArray) -> RealArray:
        return np.array([_checked(place(time), time) for time in at.tolist()])

    samples = sampled(np.linspace(0.0, duration, SAMPLES))
    accuracy = max(ACCURACY * float(np.ptp(samples, axis=0).max()), ROUNDING * float(abs(samples).max()))
    found = [
        piece
        for begin, end in pairwise(points)
        for piece in _pieces(sampled, begin, end, accuracy, SHORTEST * duration)
    ]
    trajectory = PiecewisePolynomial(
        np.array([*(start for start, _ in found), duration]), np.stack([each for _, each in found], axis=1)
    )
    _check_velocity(trajectory)
    return trajectory


def coordinates_of(motion: OwnMotion | Trajectory) -> str:
    """Return what a motion gives, "end-effector" or "joints".

    Raises:
        TrajectoryError: its ``coordinates`` are neither.
    """
    found = getattr(motion, "coordinates", "end-effector")
    if found not in ("end-effector", "joints"):
        raise TrajectoryError(f"`coordinates` of an own motion must be 'end-effector' or 'joints', got {found!r}")
    return str(found)


def _checked(position: Any, time: float) -> tuple[float, float]:
    """Return a position as two numbers."""
    try:
        first, second = (float(value) for value in position)
    except (TypeError, ValueError):
        raise TrajectoryError(f"position({time:g}) must return two numbers, got {position!r}") from None
    if not (np.isfinite(first) and np.isfinite(second)):
        raise TrajectoryError(f"position({time:g}) must return two finite numbers, got {position!r}")
    return first, second


def _pieces(
    sampled: Callable[[RealArray], RealArray], begin: float, end: float, accuracy: float, shortest: float
) -> list[tuple[float, RealArray]]:
    """Return start [s] and Taylor coefficients (degree + 1, 2) of each polynomial between two times."""
    half = 0.5 * (end - begin)
    values = sampled(begin + half * (1.0 + NODES))
    # relative to the first one, so that rounding gives a standstill no velocity
    first = values[0]
    values = values - first
    # every other node predicts those between them
    error = abs(PREDICTION @ values[::2] - values).max()
    if error <= accuracy:
        # Chebyshev coefficients first: rounding errors of the highest stay as small as these
        coefficients = (TAYLOR @ (CHEBYSHEV @ values)) * half ** -np.arange(DEGREE + 1.0)[:, np.newaxis]
        coefficients[0] += first
        return [(begin, coefficients)]
    middle = begin + half
    if half < shortest:
        raise TrajectoryError(
            f"the own motion isn't smooth near {middle:.6g} s: add this instant to its `breakpoints` if its acceleration or a higher "
            "derivative jumps there; position and velocity must not"
        )
    both = ((begin, middle), (middle, end))
    return [piece for left, right in both for piece in _pieces(sampled, left, right, accuracy, shortest)]


def _check_velocity(motion: PiecewisePolynomial) -> None:
    """Raise TrajectoryError unless the motion begins and ends at rest, without a jump of the velocity between."""
    points = np.array(motion.breakpoints)
    positions, velocities = abs(motion.evaluate(np.linspace(0.0, motion.duration, 1000), 1)).max(axis=(1, 2))
    # rounding errors of the velocity grow with degree² / interval, by Markov's inequality
    rounding = ROUNDING * positions * DEGREE**2 / np.diff(points).min()
    jumps = abs(motion.evaluate(points, 1, "right")[1] - motion.evaluate(points, 1, "left")[1]).max(axis=1)
    worst = int(jumps.argmax())
    if jumps[worst] > max(AT_REST * velocities, rounding):
        raise TrajectoryError(
            f"the velocity of the own motion jumps by {jumps[worst]:.4g} per second at {points[worst]:.6g} s: it must begin and "
            "end at rest, and its velocity must be continuous"
        )
