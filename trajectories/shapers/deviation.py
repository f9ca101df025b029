"""How far a motion strays from a planned path."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.trajectory import Trajectory

POINTS_ON_PATH = 2000
"""Points of the path among which the nearest one is looked up first; 0.2 mm apart on a path of 0.4 m."""

POINTS_PER_INTERVAL = 60
"""Instants between two breakpoints at which the distance is looked at first."""

NEWTON_STEPS = 6
"""Steps to the foot of the perpendicular; quadratic convergence from 0.1 mm ends at rounding after four. The nearest of
all points on the way counts, so that a step too far does no harm."""

FLATTEST = 0.1
"""Smallest slope of Newton's method, 1 on a straight path; near the centre of a curve's curvature it vanishes."""

REFINEMENTS = 6
"""Rounds in which the neighbourhood of the largest distance shrinks to a quarter, to a thousandth of a millisecond; the
distance near its maximum changes with the square of that."""


def path_deviation(motion: Trajectory, path: PickAndPlacePath) -> float:
    """Largest distance [m] of a motion's positions from the nearest point of the path.

    Args:
        motion: end effector, x and y [m] in time.
        path: the planned path.
    """
    spans = [np.linspace(a, b, POINTS_PER_INTERVAL, endpoint=False) for a, b in pairwise(motion.breakpoints)]
    time = np.concatenate([*spans, [motion.duration]])
    nearest = _NearestPoint(path)
    distance = nearest.distances(motion.evaluate(time, 0)[0])
    worst = int(np.argmax(distance))
    low, high = time[max(worst - 1, 0)], time[min(worst + 1, len(time) - 1)]
    largest = float(distance[worst])
    for _ in range(REFINEMENTS):
        grid = np.linspace(low, high, 9)
        found = nearest.distances(motion.evaluate(grid, 0)[0])
        best = int(np.argmax(found))
        largest = max(largest, float(found[best]))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, 8)]
    return largest


class _NearestPoint:
    """Distances from a path, by its nearest sample and Newton's method from there."""

    def __init__(self, path: PickAndPlacePath) -> None:
        self._path = path
        self._arc_lengths = np.linspace(0.0, path.length, POINTS_ON_PATH)
        self._tree = cKDTree(np.stack([jet.value for jet in path.jets(self._arc_lengths, 0)], axis=-1))

    def distances(self, positions: RealArray) -> RealArray:
        """Distances [m] of positions (N, 2) [m], shape (N,)."""
        distance, index = self._tree.query(positions)
        s = self._arc_lengths[index]
        for _ in range(NEWTON_STEPS):
            point, tangent, curvature = (
                np.stack([x, y], axis=-1)
                for x, y in zip(*(jet.derivatives() for jet in self._path.jets(s, 2)), strict=True)
            )
            offset = point - positions
            distance = np.minimum(distance, np.linalg.norm(offset, axis=-1))
            slope = np.sum(tangent**2 + offset * curvature, axis=-1)
            step = np.sum(offset * tangent, axis=-1) / np.maximum(slope, FLATTEST)
            s = np.clip(s - step, 0.0, self._path.length)
        return np.asarray(distance)
