"""Shaped joint references, the resulting motion of the rigid end effector, and its deviation from the path.

The convolution of a motion q with an impulse sequence is Σ A_i q(t - T_i); its derivatives are sums of the same kind. As the
kinematics are nonlinear, the rigid end effector deviates a little from its path.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.errors import times
from flexfmu.trajectories.jets import Jet, RealArray, checked_order
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.trajectory import SAME_TIME, Trajectory, merged

POINTS_ON_PATH = 2000
"""Points of the path among which the nearest one is searched first; 0.2 mm apart on a path of 0.4 m."""

POINTS_PER_INTERVAL = 60
"""Initial samples of the distance between two breakpoints."""

NEWTON_STEPS = 6
"""Newton steps to the foot of the perpendicular; convergence from 0.1 mm is quadratic and reaches rounding after four. The smallest
distance of all iterates counts, so that an overshooting step does no harm."""

FLATTEST = 0.1
"""Lower bound of the slope in Newton's method, relative to the slope of a straight path. It vanishes at a centre of curvature."""

REFINEMENTS = 6
"""Rounds of refinement; in each the neighbourhood of the largest distance shrinks to a quarter, at last to about a microsecond. The
error of the maximum is of the order of its square."""


@dataclass(frozen=True)
class ShapedTrajectory:
    """The shaped motion Σ A_i q(t - T_i) of a motion q.

    Attributes:
        trajectory: the motion q.
        sequence: impulses A_i at T_i.
    """

    trajectory: Trajectory
    sequence: ImpulseSequence

    @property
    def duration(self) -> float:
        """Duration of the motion [s]: the sum of the durations of q and of the sequence."""
        return self.trajectory.duration + self.sequence.duration

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which a derivative may jump: the breakpoints of q, delayed by the time of each impulse."""
        shifted = [point + delay for delay in self.sequence.times for point in self.trajectory.breakpoints]
        return merged([0.0, self.duration], shifted, 0.5 * SAME_TIME * self.trajectory.duration)

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return the coordinates and their time derivatives, (order + 1, N, 2); see `flexfmu.trajectories.Trajectory.evaluate`."""
        # all delays in one call, then the weighted sum
        delayed = times(time) - np.array(self.sequence.times)[:, np.newaxis]
        parts = self.trajectory.evaluate(delayed.ravel(), checked_order(order), side)
        parts = parts.reshape(order + 1, *delayed.shape, parts.shape[-1])
        return np.asarray(np.einsum("i,kinc->knc", np.array(self.sequence.amplitudes), parts))


class ForwardKinematics(Protocol):
    """Forward kinematics of a mechanism."""

    def end_effector(self, q11: Jet, q21: Jet) -> tuple[Jet, Jet]:
        """Return jets of the end effector's x and y [m] from jets of the joint angles [rad]."""
        ...


@dataclass(frozen=True)
class EndEffectorTrajectory:
    """Motion of the rigid end effector, x and y [m], from the motion of the joints by forward kinematics.

    Attributes:
        joints: motion of the joints, q11 and q21 [rad].
        kinematics: the mechanism's forward kinematics.
    """

    joints: Trajectory
    kinematics: ForwardKinematics

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.joints.duration

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which a derivative may jump: the breakpoints of ``joints``."""
        return self.joints.breakpoints

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return x and y [m] and their time derivatives, (order + 1, N, 2); see `flexfmu.trajectories.Trajectory.evaluate`."""
        # forward kinematics of the series in time
        motion = Jet.from_derivatives(self.joints.evaluate(time, checked_order(order), side))
        q11, q21 = (Jet(motion.coefficients[:, :, i]) for i in (0, 1))
        return np.stack([jet.derivatives() for jet in self.kinematics.end_effector(q11, q21)], axis=-1)


def path_deviation(motion: Trajectory, path: PickAndPlacePath | Trajectory) -> float:
    """Return the largest distance [m] between the end effector and the nearest point of the path.

    Args:
        motion: motion of the end effector, x and y [m].
        path: the planned path, or a motion along it.
    """
    from scipy.spatial import cKDTree  # here, since most motions need no scipy

    # points of the path and their derivatives by arc length, or by time
    if isinstance(path, PickAndPlacePath):
        places = np.linspace(0.0, path.length, POINTS_ON_PATH)
    else:
        places = np.unique(np.concatenate([np.linspace(0.0, path.duration, POINTS_ON_PATH), path.breakpoints]))

    def points(place: RealArray, order: int) -> RealArray:
        """Return points of the path and their derivatives (order + 1, N, 2) at places (N,)."""
        if isinstance(path, PickAndPlacePath):
            return np.stack([jet.derivatives() for jet in path.jets(place, order)], axis=-1)
        return path.evaluate(place, order)

    tree = cKDTree(points(places, 0)[0])

    def distances(positions: RealArray) -> RealArray:
        """Return the distances (N,) [m] of positions (N, 2) [m] from the path, by Newton's method from the nearest sample."""
        distance, index = tree.query(positions)
        place = places[index]
        for _ in range(NEWTON_STEPS):
            point, tangent, curvature = points(place, 2)
            # at the foot of the perpendicular, offset and tangent are orthogonal
            offset = point - positions
            distance = np.minimum(distance, np.linalg.norm(offset, axis=-1))
            steepness = np.sum(tangent**2, axis=-1)
            slope = np.maximum(steepness + np.sum(offset * curvature, axis=-1), FLATTEST * steepness)
            # at a standstill there is no direction to go
            step = np.sum(offset * tangent, axis=-1) / np.where(slope > 0.0, slope, np.inf)
            place = np.clip(place - step, 0.0, places[-1])
        return np.asarray(distance)

    # largest distance among the samples
    spans = [np.linspace(a, b, POINTS_PER_INTERVAL, endpoint=False) for a, b in pairwise(motion.breakpoints)]
    time = np.concatenate([*spans, [motion.duration]])
    distance = distances(motion.evaluate(time, 0)[0])
    worst = int(np.argmax(distance))
    # refine around it
    low, high = time[max(worst - 1, 0)], time[min(worst + 1, len(time) - 1)]
    largest = float(distance[worst])
    for _ in range(REFINEMENTS):
        grid = np.linspace(low, high, 9)
        found = distances(motion.evaluate(grid, 0)[0])
        best = int(np.argmax(found))
        largest = max(largest, float(found[best]))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, 8)]
    return largest
