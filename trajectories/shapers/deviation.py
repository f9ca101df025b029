"""How far a motion strays from a planned path."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from flexfmu.trajectories.jets import Array
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.trajectory import Trajectory

POINTS_ON_PATH = 2000
"""Points of the path among which the nearest one is looked up first; 0.2 mm apart on a path of 0.4 m."""

POINTS_PER_INTERVAL = 60
"""Instants between two breakpoints at which the distance is looked at first."""

NEWTON_STEPS = 8
"""Steps to the foot of the perpendicular; quadratic convergence from 0.1 mm ends at rounding after four."""

REFINEMENTS = 12
"""Rounds in which the neighbourhood of the largest distance shrinks to a quarter."""


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

    def distances(self, positions: Array) -> Array:
        """Distances [m] of positions (N, 2) [m], shape (N,)."""
        distance, index = self._tree.query(positions)
        s = self._arc_lengths[index]
        for _ in range(NEWTON_STEPS):
            trial = np.clip(self._newton(s, positions), 0.0, self._path.length)
            found = np.linalg.norm(self._derivatives(trial, 0)[0] - positions, axis=-1)
            s = np.where(found < distance, trial, s)
            distance = np.minimum(found, distance)
        return np.asarray(distance)

    def _newton(self, s: Array, positions: Array) -> Array:
        """Arc lengths nearer to where the line to the position is perpendicular to the path."""
        point, tangent, curvature = self._derivatives(s, 2)
        offset = point - positions
        slope = np.sum(tangent**2 + offset * curvature, axis=-1)
        return np.asarray(s - np.sum(offset * tangent, axis=-1) / np.maximum(slope, 0.1))

    def _derivatives(self, s: Array, order: int) -> Array:
        """Points of the path and their derivatives by arc length, shape (order + 1, N, 2)."""
        return np.stack([jet.derivatives() for jet in self._path.jets(s, order)], axis=-1)
