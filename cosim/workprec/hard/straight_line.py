"""The shortest motion: on a straight line from rest to rest, without the blends of a pick-and-place path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray

from flexfmu.cosim.planning import MotionPlan
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene import Scene
from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.jets import Jet
from flexfmu.trajectories.joint import InverseKinematics, JointTrajectory, Margin

Array = NDArray[np.float64]

PROFILE = Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
"""Fraction of the way over the fraction of the duration: rates, accelerations and jerks vanish at both ends."""


@dataclass(frozen=True)
class StraightLine:
    """Implements `flexfmu.trajectories.Trajectory`.

    Attributes:
        start, end: x and y [m].
        duration: [s].
    """

    start: tuple[float, float]
    end: tuple[float, float]
    duration: float

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Beginning and end [s]."""
        return (0.0, self.duration)

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> Array:
        """(order + 1, N, 2) position [m] and its time derivatives."""
        instants = np.atleast_1d(np.asarray(time, dtype=np.float64))
        right = side == "right"
        moves = (
            (instants >= 0.0) & (instants < self.duration) if right else (instants > 0.0) & (instants <= self.duration)
        )
        fraction = np.clip(instants / self.duration, 0.0, 1.0)
        ways = [PROFILE.deriv(k)(fraction) / self.duration**k for k in range(order + 1)]
        travelled = np.stack([ways[0], *(np.where(moves, way, 0.0) for way in ways[1:])])
        motion = travelled[:, :, np.newaxis] * np.subtract(self.end, self.start)
        motion[0] += self.start
        return np.asarray(motion)


@dataclass(frozen=True)
class Unguarded:
    """Inverse kinematics without the margins that planning keeps, as a careless controller has."""

    kinematics: RigidKinematics

    def joints(self, x: Jet, y: Jet) -> tuple[Jet, Jet]:
        """Those of the guarded one."""
        return self.kinematics.joints(x, y)

    def margins(self, position: Array) -> tuple[Margin, ...]:
        """None at all."""
        return ()


def straight_motion(
    base: MotionPlan,
    scene: Scene,
    line: StraightLine,
    guard: Callable[[RigidKinematics], InverseKinematics] = lambda kinematics: kinematics,
) -> MotionPlan:
    """A plan with the line in place of the scene's path.

    Args:
        base: a plan; what has to do with its path is replaced.
        scene: whose mechanism moves.
        line: the motion.
        guard: what to make of the inverse kinematics, for example `Unguarded`.

    Raises:
        TrajectoryError: the line leaves the workspace or comes too near to a singularity.
    """
    kinematics = RigidKinematics(scene.mechanism)
    joints = JointTrajectory(line, guard(kinematics))
    return replace(base, scene=scene, kinematics=kinematics, task=line, joints=joints)
