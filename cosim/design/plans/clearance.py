"""Where the end effector may go: signed distances to the regions that it must keep clear of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.assembly import bases
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.trajectories.jets import RealArray

FEW = 50
"""Polygons with more corners have about equal sides."""

TOUCHING = 1e-9
"""Distance [m] below which a point lies on the outline."""

ROUND = 10.0
"""A way passes through a region where both ways round are further from it than this multiple of its depth: walls, not corners."""

RETURN = 1e-6
"""Distance from start to end [m] below which a motion returns."""

PARTS, REFINED, PEAKS = 8, 33, 4
"""Parts of each segment at which the depth within a region is looked at; points about each of so many peaks, three times."""


def to_nearest(points: RealArray, first: RealArray, side: RealArray) -> tuple[RealArray, RealArray, NDArray[np.intp]]:
    """From the nearest of some sides to each point: vectors (N, 2) [m], places along the sides' lines, 0..1 within them, and which ones (N,).

    Args:
        points: (N, 2) [m].
        first, side: first points and vectors of K sides, the same for all points (K, 2), or those of each (N, K, 2) [m].
    """
    away = points[:, np.newaxis] - first
    along = (away * side).sum(axis=-1) / np.maximum((side**2).sum(axis=-1), TOUCHING**2)
    away = away - np.clip(along, 0.0, 1.0)[..., np.newaxis] * side
    rows, nearest = np.arange(len(points)), (away**2).sum(axis=-1).argmin(axis=1)
    return away[rows, nearest], along[rows, nearest], nearest


@dataclass(frozen=True)
class Stretch:
    """A stretch of a way within a region.

    Attributes:
        deepest: where it is deepest, as a number of the way's points, with a fraction.
        depth: that depth [m].
        around: how far the way would have to move [m] to go around what it passes through; 0 where it only dips in.
    """

    deepest: float
    depth: float
    around: float


@dataclass(frozen=True, eq=False)
class Polygon:
    """A keep-out region.

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
        side, sides = self._sides, self._near(points)
        away, along, nearest = to_nearest(points, self.corners[sides], side[sides])
        chosen = sides[np.arange(len(points)), nearest]
        # outside is where the normal points to; at a corner the sum of both sides' normals
        unit = side / np.hypot(*side.T)[:, None]
        normals = np.column_stack([unit[:, 1], -unit[:, 0]])
        other = np.where(along <= 0.0, chosen - 1, np.where(along >= 1.0, (chosen + 1) % len(side), chosen))
        normal = normals[chosen] + normals[other]
        distance = np.hypot(*away.T)
        sign = np.where(np.einsum("nj,nj->n", away, normal) < 0.0, -1.0, 1.0)
        gradient = away * (sign / np.maximum(distance, TOUCHING))[:, None]
        return sign * distance, np.where((distance > TOUCHING)[:, None], gradient, normals[chosen])

    def of_segments(self, start: RealArray, end: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        """Distances (N,) [m] of segments between points (N, 2), and their gradients by both points (N, 2).

        A segment that is partly inside is as far from it as it would have to move sideways, negative.
        """
        line = end - start
        length = np.hypot(*line.T)[:, np.newaxis]
        normal = np.stack([-line[:, 1], line[:, 0]], axis=-1) / length
        away = self.corners - start[:, np.newaxis]
        offset, along = (np.einsum("nkj,nj->nk", away, each) for each in (normal, line / length**2))
        # beside a corner, or at an end
        beside = np.where((along > 0.0) & (along < 1.0), np.abs(offset), np.inf)
        ends, slopes = (np.stack(each) for each in zip(self.distance(start), self.distance(end), strict=True))
        rows, corner, tip = np.arange(len(start)), beside.argmin(axis=1), ends.argmin(axis=0)
        is_corner = beside[rows, corner] < ends.min(axis=0)
        # sides whose ends lie on both sides of the line cross it, within the segment or beyond
        other, further = np.roll(offset, -1, axis=1), np.roll(along, -1, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            place = along + (further - along) * offset / (offset - other)
        crosses = ((offset * other < 0.0) & (place > 0.0) & (place < 1.0)).any(axis=1) | (ends < 0.0).any(axis=0)
        aside = np.where(offset.max(axis=1) < -offset.min(axis=1), offset.argmax(axis=1), offset.argmin(axis=1))
        corner = np.where(crosses, aside, corner)
        height, share = offset[rows, corner], np.clip(along[rows, corner], 0.0, 1.0)
        sideways = np.where(crosses, 1.0, -1.0)[:, np.newaxis] * np.sign(height)[:, np.newaxis] * normal
        distance = np.where(crosses, -np.abs(height), np.where(is_corner, np.abs(height), ends.min(axis=0)))
        is_corner |= crosses
        share = np.where(is_corner, share, tip)[:, np.newaxis]
        gradient = np.where(is_corner[:, np.newaxis], sideways, slopes[tip, rows])
        return distance, (1.0 - share) * gradient, share * gradient

    def stretches(self, points: RealArray) -> list[Stretch]:
        """Where a way, straight between points (N, 2), is within the polygon, however thin that is there."""
        index, sides = self._crossings(points)
        bounds = np.concatenate([[0.0], index, [len(points) - 1.0]])
        inside = self.distance(interpolated(points, 0.5 * (bounds[1:] + bounds[:-1])))[0] < -TOUCHING
        # parts that follow each other are one stretch
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
        found = []
        for first, last in edges.reshape(-1, 2):
            low, high = bounds[first], bounds[last]
            steps = np.arange(np.ceil(low * PARTS), np.floor(high * PARTS) + 1.0) / PARTS
            where = np.unique(np.concatenate([np.linspace(low, high, REFINED), steps]))
            for _ in range(4):
                depth = -self.distance(interpolated(points, where))[0]
                k = int(depth.argmax())
                deepest, most = float(where[k]), float(depth[k])
                # corners of the region bend the depth: what is nearly as deep may be deeper beside it
                rise = np.diff(depth, prepend=-np.inf, append=-np.inf)
                peaks = np.flatnonzero((rise[:-1] >= 0.0) & (rise[1:] <= 0.0))
                peaks = peaks[np.argsort(-depth[peaks])][:PEAKS]
                ends = where[np.maximum(peaks - 1, 0)], where[np.minimum(peaks + 1, len(where) - 1)]
                where = np.unique(np.linspace(*ends, REFINED))
            around = 0.0
            if first > 0 and last < len(bounds) - 1:
                numbers = np.concatenate([[low], np.arange(np.floor(low) + 1.0, np.ceil(high)), [high]])
                around = self._around(interpolated(points, numbers), sides[first - 1], sides[last - 1])
            found.append(Stretch(deepest, most, around if around > ROUND * most else 0.0))
        return found

    def _crossings(self, points: RealArray) -> tuple[RealArray, NDArray[np.intp]]:
        """Where a way crosses the outline: ascending numbers of its points, with fractions, and the sides."""
        # segments near the outline
        ends = np.stack([points[:-1], points[1:]])
        near = (ends.max(axis=0) >= self.corners.min(axis=0)) & (ends.min(axis=0) <= self.corners.max(axis=0))
        number = np.flatnonzero(near.all(axis=1))
        start, along = points[number, None], (points[number + 1] - points[number])[:, None]
        away, side, turn = self.corners - start, self._sides, _cross(along, self._sides)
        with np.errstate(divide="ignore", invalid="ignore"):
            t, u = _cross(away, side) / turn, _cross(away, along) / turn
        rows, sides = np.nonzero((turn != 0.0) & (t >= 0.0) & (t <= 1.0) & (u >= 0.0) & (u <= 1.0))
        index, first = np.unique(number[rows] + t[rows, sides], return_index=True)
        return index, sides[first]

    def _around(self, way: RealArray, enters: int, leaves: int) -> float:
        """How far the nearer of both outlines between two of its sides is from the way between them [m]."""
        first, last = sorted((enters, leaves))
        between = (np.arange(len(self.corners)) > first) & (np.arange(len(self.corners)) <= last)
        away, _, _ = to_nearest(self.corners, way[:-1], np.diff(way, axis=0))
        distance = np.hypot(*away.T)
        return min(float(distance[chosen].max(initial=0.0)) for chosen in (between, ~between))

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

    @cached_property
    def _sides(self) -> RealArray:
        """Vectors (N, 2) [m] from each corner to the next."""
        return np.roll(self.corners, -1, axis=0) - self.corners


@dataclass(frozen=True, eq=False)
class Clearance:
    """Regions to keep clear of, and lines not to cross.

    Attributes:
        regions: polygons.
        lines: an origin (2,) [m] and a normal (2,) of length 1 each; the side that the normal points to is allowed.
        thin: whether regions may be thinner than the distance of a way's points.
        for_links: those regions that links keep clear of too: rigid ones, round, from the bases by the elbows to the end effector.
        mechanism: has the links.
    """

    regions: tuple[Polygon, ...]
    lines: tuple[tuple[RealArray, RealArray], ...] = ()
    thin: bool = False
    for_links: tuple[Polygon, ...] = ()
    mechanism: Mechanism | None = None

    def distances(self, points: RealArray) -> tuple[RealArray, RealArray]:
        """Distances (K, ...) [m] of points (..., 2) to each region and line, negative where the point must not be, and gradients (K, ..., 2)."""
        flat = points.reshape(-1, 2)
        found = [region.distance(flat) for region in self.regions]
        found += [((flat - origin) @ normal, np.broadcast_to(normal, flat.shape)) for origin, normal in self.lines]
        if self.for_links:
            found += self._of_links(flat)
        if not found:
            return np.full((1, *points.shape[:-1]), np.inf), np.zeros((1, *points.shape))
        distance, gradient = (np.array(each) for each in zip(*found, strict=True))
        return distance.reshape(-1, *points.shape[:-1]), gradient.reshape(-1, *points.shape)

    def _of_links(self, points: RealArray) -> list[tuple[RealArray, RealArray]]:
        """Distances and gradients of the links at places of the end effector; infinite out of reach."""
        assert self.mechanism is not None
        found, robot = list[tuple[RealArray, RealArray]](), self.mechanism
        for base, elbow in zip(bases(robot), RigidKinematics(robot).elbows(points), strict=True):
            # lengths stay: the elbow turns about its base, as far as its distance from the end effector needs
            turning = np.stack([-(elbow - base)[:, 1], (elbow - base)[:, 0]], axis=-1)
            arm = elbow - points
            with np.errstate(divide="ignore", invalid="ignore"):
                share = arm / np.einsum("nj,nj->n", arm, turning)[:, np.newaxis]
            by = turning[:, :, np.newaxis] * share[:, np.newaxis]
            for region in self.for_links:
                distance, _, slope = region.of_segments(np.broadcast_to(base, points.shape), elbow)
                proximal = distance - 0.5 * robot.proximal.diameter, np.einsum("nj,njk->nk", slope, by)
                distance, of_elbow, slope = region.of_segments(elbow, points)
                distal = distance - 0.5 * robot.distal.diameter, np.einsum("nj,njk->nk", of_elbow, by) + slope
                for distance, gradient in (proximal, distal):
                    found.append((np.where(np.isnan(distance), np.inf, distance), np.nan_to_num(gradient)))
        return found

    def of_ways(self, ways: RealArray) -> tuple[RealArray, RealArray]:
        """The same for points of ways (P, N, 2), where what a way passes through counts by the way around it, with gradients of zero."""
        distance, gradient = self.distances(ways)
        for p, way in enumerate(ways):
            for k, each in self._stretches(way):
                if each.around:
                    place = k, p, round(each.deepest)
                    distance[place], gradient[place] = min(distance[place], -each.around), 0.0
        return distance, gradient

    def distance(self, points: RealArray) -> RealArray:
        """The smallest of these distances (N,) [m]."""
        return np.asarray(self.distances(points)[0].min(axis=0))

    def along(self, points: RealArray) -> RealArray:
        """The smallest of these distances (N,) [m] on a way, straight between points (N, 2); what it passes through counts by the way around it."""
        found = self.distance(points)
        for _, each in self._stretches(points):
            number = round(each.deepest)
            found[number] = min(found[number], -max(each.depth, each.around))
        if self.for_links:
            # corners pass links between the points
            nearest = int(found.argmin())
            around = np.linspace(max(nearest - 1, 0), min(nearest + 1, len(points) - 1), REFINED)
            found[nearest] = min(found[nearest], float(self.distance(interpolated(points, around)).min()))
        return found

    def passage(self, points: RealArray) -> float:
        """How far a way would have to move to go around all regions that it passes through [m]; 0 if there are none."""
        return max((each.around for _, each in self._stretches(points)), default=0.0)

    def _stretches(self, way: RealArray) -> list[tuple[int, Stretch]]:
        """Numbers of regions, with stretches of a way within them."""
        return (
            [(k, each) for k, region in enumerate(self.regions) for each in region.stretches(way)] if self.thin else []
        )


def _cross(one: RealArray, other: RealArray) -> RealArray:
    """Cross products of vectors in a plane, along the last axis."""
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def lengths(points: RealArray) -> RealArray:
    """Lengths (N,) [m] along a way, straight between points (N, 2)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def interpolated(points: RealArray, where: RealArray, places: RealArray | None = None) -> RealArray:
    """Points between others, at ascending places; without places at numbers with fractions."""
    known = np.arange(len(points)) if places is None else places
    return np.column_stack([np.interp(where, known, each) for each in points.T])


def _evenly(corners: RealArray) -> RealArray:
    """The corners with more between them, so that all sides are about as long as the shortest half."""
    corners = corners[np.hypot(*(np.roll(corners, -1, axis=0) - corners).T) > TOUCHING]
    closed = np.concatenate([corners, corners[:1]])
    length = np.hypot(*np.diff(closed, axis=0).T)
    parts = np.ceil(length / (1.5 * np.median(length))).astype(int)
    return interpolated(closed, np.concatenate([k + np.arange(n) / n for k, n in enumerate(parts)]))


def clearance_of_trace(trace: RealArray, corridor: float, below: float) -> Clearance:
    """What a motion clears: the region between its trace and the chord from start to end with all below it, and a corridor around it.

    Args:
        trace: points of the motion (N, 2) [m].
        corridor: how far beyond the trace the end effector may swing, sideways and in height [m].
        below: how far below the chord [m].
    """
    start, end = trace[0], trace[-1]
    width = float(np.hypot(*(end - start)))
    is_return = width < RETURN
    across = np.array([1.0, 0.0]) if is_return else (end - start) / width
    up = np.array([-across[1], across[0]])
    heights = (trace - start) @ up
    up = up if abs(heights.max()) >= abs(heights.min()) else -up
    u, v = (trace - start) @ across, (trace - start) @ up
    low = v.min() - corridor if is_return else min(v.min(), 0.0) - below
    sides = ((u.min() - corridor, across), (-u.max() - corridor, -across), (-v.max() - corridor, -up), (low, up))
    lines = tuple((start + distance * normal, normal) for distance, normal in sides)
    if is_return:
        # a corridor alone
        return Clearance((), lines)
    # one region with what lies below the chord, or the chord itself would be a way between them; the robot may sag at both ends
    inset, depth = (2.0 * below + TOUCHING) * across, (below + 2.0 * v.max() - min(v.min(), 0.0)) * up
    wall = np.array([end - inset, end - inset - depth, start + inset - depth, start + inset])
    return Clearance((Polygon.of(np.concatenate([trace, wall])),), lines)
