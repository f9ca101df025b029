"""Where the end effector may go: signed distances to the regions that it must keep clear of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from flexfmu.trajectories.jets import RealArray

FEW = 50
"""Polygons with more corners have about equal sides."""

TOUCHING = 1e-9
"""Distance [m] below which a point lies on the outline."""


@dataclass(frozen=True, eq=False)
class Polygon:
    """A region that is kept clear.

    Attributes:
        corners: in order, counter-clockwise (N, 2) [m].
    """

    corners: RealArray

    @staticmethod
    def of(points: Sequence[Sequence[float]] | RealArray) -> Polygon:
        """The polygon of these corners, in any sense of rotation."""
        corners = np.asarray(points, dtype=float)
        if len(corners) > FEW:
            corners = _evenly(corners)
        x, y = corners.T
        area = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
        return Polygon(corners if area > 0.0 else corners[::-1].copy())

    def distance(self, points: RealArray) -> tuple[RealArray, RealArray]:
        """Distances (N,) [m] of points (N, 2), negative inside, and their gradients (N, 2)."""
        side = np.roll(self.corners, -1, axis=0) - self.corners
        sides = self._near(points)
        # the nearest point of each of these sides, then of all
        away = points[:, None] - self.corners[sides]
        along = np.einsum("nkj,nkj->nk", away, side[sides]) / np.einsum("nkj,nkj->nk", side[sides], side[sides])
        away = away - np.clip(along, 0.0, 1.0)[..., None] * side[sides]
        rows, nearest = np.arange(len(points)), np.einsum("nkj,nkj->nk", away, away).argmin(axis=1)
        chosen, along, away = sides[rows, nearest], along[rows, nearest], away[rows, nearest]
        # outside is where the normal points to; at a corner the sum of both sides' normals
        unit = side / np.hypot(*side.T)[:, None]
        normals = np.column_stack([unit[:, 1], -unit[:, 0]])
        other = np.where(along <= 0.0, chosen - 1, np.where(along >= 1.0, (chosen + 1) % len(side), chosen))
        normal = normals[chosen] + normals[other]
        distance = np.hypot(*away.T)
        sign = np.where(np.einsum("nj,nj->n", away, normal) < 0.0, -1.0, 1.0)
        gradient = away * (sign / np.maximum(distance, TOUCHING))[:, None]
        return sign * distance, np.where((distance > TOUCHING)[:, None], gradient, normals[chosen])

    def _near(self, points: RealArray) -> NDArray[np.intp]:
        """Sides (N, k) of which one is the nearest to each point; few of many equal ones, otherwise all."""
        count = len(self.corners)
        if count <= FEW:
            return np.broadcast_to(np.arange(count), (len(points), count))
        _, corners = self._tree.query(points, 3)
        return np.concatenate([corners, corners - 1], axis=1) % count

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.corners)


@dataclass(frozen=True, eq=False)
class Clearance:
    """Regions to keep clear of, and lines not to cross.

    Attributes:
        regions: polygons.
        origins, normals: of lines, (L, 2) [m] and unit vectors; the side that the normal points to is allowed.
    """

    regions: tuple[Polygon, ...]
    origins: RealArray
    normals: RealArray

    def distances(self, points: RealArray) -> tuple[RealArray, RealArray]:
        """Distances (K, N) [m] of points (N, 2) to each region and line, negative where the point must not be, and gradients (K, N, 2)."""
        found = [region.distance(points) for region in self.regions]
        for origin, normal in zip(self.origins, self.normals, strict=True):
            found.append(((points - origin) @ normal, np.broadcast_to(normal, points.shape)))
        if not found:
            return np.full((1, len(points)), np.inf), np.zeros((1, *points.shape))
        return np.array([each for each, _ in found]), np.array([each for _, each in found])

    def distance(self, points: RealArray) -> RealArray:
        """The smallest of these distances (N,) [m]."""
        return np.asarray(self.distances(points)[0].min(axis=0))

    def normal(self, points: RealArray) -> RealArray:
        """Gradients (N, 2) of `distance`."""
        distance, gradient = self.distances(points)
        return np.asarray(gradient[distance.argmin(axis=0), np.arange(len(points))])


def _evenly(corners: RealArray) -> RealArray:
    """The corners with more between them, so that all sides are about as long as the shortest half."""
    side = np.roll(corners, -1, axis=0) - corners
    length = np.hypot(*side.T)
    kept = length > TOUCHING
    corners, side, length = corners[kept], side[kept], length[kept]
    parts = np.ceil(length / (1.5 * np.median(length))).astype(int)
    return np.concatenate([a + b * (np.arange(n) / n)[:, None] for a, b, n in zip(corners, side, parts, strict=True)])


def clearance_of_trace(trace: RealArray, corridor: float, below: float) -> Clearance:
    """What a motion clears: the region between its trace and the chord from start to end, and a corridor around it.

    Args:
        trace: points of the motion (N, 2) [m].
        corridor: how far beyond the trace the end effector may swing, sideways and in height [m].
        below: how far below the chord [m].
    """
    start, end = trace[0], trace[-1]
    width = float(np.hypot(*(end - start)))
    if width < 1e-6:
        # there and back: a corridor alone
        low, high = trace.min(axis=0) - corridor, trace.max(axis=0) + corridor
        return Clearance(
            (), np.array([low, low, high, high]), np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
        )
    across = (end - start) / width
    up = np.array([-across[1], across[0]])
    heights = (trace - start) @ up
    up = up if abs(heights.max()) >= abs(heights.min()) else -up
    u, v = (trace - start) @ across, (trace - start) @ up
    origins = np.array(
        [
            start + (u.min() - corridor) * across,
            start + (u.max() + corridor) * across,
            start + (v.max() + corridor) * up,
            start + (min(v.min(), 0.0) - below) * up,
        ]
    )
    return Clearance((Polygon.of(trace),), origins, np.array([across, -across, -up, up]))
