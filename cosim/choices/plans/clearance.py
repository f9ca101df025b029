"""Where the end effector may go: signed distances to the regions that it must keep clear of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexfmu.trajectories.jets import RealArray


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
        x, y = corners.T
        area = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
        return Polygon(corners if area > 0.0 else corners[::-1].copy())

    def distance(self, points: RealArray) -> tuple[RealArray, RealArray]:
        """Distances (N,) [m] of points (N, 2), negative inside, and their gradients (N, 2)."""
        start = self.corners
        side = np.roll(start, -1, axis=0) - start
        length = np.einsum("kj,kj->k", side, side)
        from_start = points[:, None] - start
        # the nearest point of each side, then of all
        along = np.clip(np.einsum("nkj,kj->nk", from_start, side) / length, 0.0, 1.0)
        away = from_start - along[..., None] * side
        nearest = np.einsum("nkj,nkj->nk", away, away).argmin(axis=1)
        rows = np.arange(len(points))
        away = away[rows, nearest]
        distance = np.hypot(*away.T)
        sign = np.where(self._inside(points), -1.0, 1.0)
        # on the outline the gradient is the side's normal
        chosen = side[nearest] / np.sqrt(length[nearest])[:, None]
        normal = np.column_stack([chosen[:, 1], -chosen[:, 0]])
        away_from = away * (sign / np.maximum(distance, 1e-300))[:, None]
        return sign * distance, np.where((distance > 1e-9)[:, None], away_from, normal)

    def _inside(self, points: RealArray) -> RealArray:
        """Whether points lie inside, by the crossings of a ray along x."""
        x, y = points[:, 0, None], points[:, 1, None]
        (x1, y1), (x2, y2) = self.corners.T, np.roll(self.corners, -1, axis=0).T
        crosses = (y1 > y) != (y2 > y)
        slope = np.divide(x2 - x1, y2 - y1, out=np.zeros_like(x1), where=y1 != y2)
        return np.asarray((crosses & (x < x1 + (y - y1) * slope)).sum(axis=1) % 2 == 1)


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
