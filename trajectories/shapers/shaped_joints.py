"""Shaping the joint references: the shaped motion, the end effector's motion that follows, and its distance from the path.

A motion convolved with an impulse sequence is the sum Σ A_i q(t - T_i), which is evaluated as it stands, with all its
derivatives. The rigid end effector leaves its path by a little, since the kinematics are not linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.errors import times
from flexfmu.trajectories.jets import Jet, RealArray, checked_order
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.trajectory import SAME_TIME, Trajectory, merged

POINTS_ON_PATH = 2000
"""Points of the path among which the nearest one is found first; 0.2 mm apart on a path of 0.4 m."""

POINTS_PER_INTERVAL = 60
"""Instants between two breakpoints at which the distance is evaluated first."""

NEWTON_STEPS = 6
"""Steps to the foot of the perpendicular; quadratic convergence from 0.1 mm ends at rounding after four. The nearest of
all points on the way counts, so that a step too far does no harm."""

FLATTEST = 0.1
"""Smallest slope of Newton's method, 1 on a straight path; near the centre of a curve's curvature it vanishes."""

REFINEMENTS = 6
"""Rounds in which the neighbourhood of the largest distance shrinks to a quarter, to a thousandth of a millisecond; the
distance near its maximum changes with the square of that."""


@dataclass(frozen=True)
class ShapedTrajectory:
    """Σ A_i q(t - T_i) for a motion q: on joint references it moves the end effector off its path a little.

    Attributes:
        trajectory: the motion q.
        sequence: impulses A_i at T_i.
    """

    trajectory: Trajectory
    sequence: ImpulseSequence

    @property
    def duration(self) -> float:
        """Duration of the motion [s]: that of q and of the sequence."""
        return self.trajectory.duration + self.sequence.duration

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which some derivative may jump: those of q, shifted by every impulse."""
        shifted = [point + delay for delay in self.sequence.times for point in self.trajectory.breakpoints]
        return merged([0.0, self.duration], shifted, 0.5 * SAME_TIME * self.trajectory.duration)

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Coordinates and their time derivatives; see `flexfmu.trajectories.Trajectory.evaluate`."""
        # all delays in one call, then the weighted sum
        delayed = times(time) - np.array(self.sequence.times)[:, np.newaxis]
        parts = self.trajectory.evaluate(delayed.ravel(), checked_order(order), side)
        parts = parts.reshape(order + 1, *delayed.shape, parts.shape[-1])
        return np.asarray(np.einsum("i,kinc->knc", np.array(self.sequence.amplitudes), parts))


class ForwardKinematics(Protocol):
    """From the actuated joints to the end effector."""

    def end_effector(self, q11: Jet, q21: Jet) -> tuple[Jet, Jet]:
        """Jets of the end effector's x and y [m] from jets of the joint angles [rad]."""
        ...


@dataclass(frozen=True)
class EndEffectorTrajectory:
    """x and y [m] of the rigid end effector in time, by forward kinematics.

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
        """Times [s] at which some derivative may jump: those of the joints."""
        return self.joints.breakpoints

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """x and y [m] and their time derivatives; see `flexfmu.trajectories.Trajectory.evaluate`."""
        # forward kinematics of the series in time
        motion = Jet.from_derivatives(self.joints.evaluate(time, checked_order(order), side))
        q11, q21 = (Jet(motion.coefficients[:, :, i]) for i in (0, 1))
        return np.stack([jet.derivatives() for jet in self.kinematics.end_effector(q11, q21)], axis=-1)


def path_deviation(motion: Trajectory, path: PickAndPlacePath) -> float:
    """Largest distance [m] of a motion's positions from the nearest point of the path.

    Args:
        motion: end effector, x and y [m] in time.
        path: the planned path.
    """
    arc_lengths = np.linspace(0.0, path.length, POINTS_ON_PATH)
    tree = cKDTree(np.stack([jet.value for jet in path.jets(arc_lengths, 0)], axis=-1))

    def distances(positions: RealArray) -> RealArray:
        """From positions (N, 2) [m] to the path [m], shape (N,): from the nearest sample by Newton's method."""
        distance, index = tree.query(positions)
        s = arc_lengths[index]
        for _ in range(NEWTON_STEPS):
            point, tangent, curvature = (
                np.stack([x, y], axis=-1) for x, y in zip(*(jet.derivatives() for jet in path.jets(s, 2)), strict=True)
            )
            # the foot of the perpendicular is where the offset has no part along the tangent
            offset = point - positions
            distance = np.minimum(distance, np.linalg.norm(offset, axis=-1))
            slope = np.sum(tangent**2 + offset * curvature, axis=-1)
            step = np.sum(offset * tangent, axis=-1) / np.maximum(slope, FLATTEST)
            s = np.clip(s - step, 0.0, path.length)
        return np.asarray(distance)

    # the largest of the samples between breakpoints
    spans = [np.linspace(a, b, POINTS_PER_INTERVAL, endpoint=False) for a, b in pairwise(motion.breakpoints)]
    time = np.concatenate([*spans, [motion.duration]])
    distance = distances(motion.evaluate(time, 0)[0])
    worst = int(np.argmax(distance))
    # then around it, on a finer grid in every round
    low, high = time[max(worst - 1, 0)], time[min(worst + 1, len(time) - 1)]
    largest = float(distance[worst])
    for _ in range(REFINEMENTS):
        grid = np.linspace(low, high, 9)
        found = distances(motion.evaluate(grid, 0)[0])
        best = int(np.argmax(found))
        largest = max(largest, float(found[best]))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, 8)]
    return largest
