"""The motion of the rigid end effector that belongs to joint references."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.jets import Jet, RealArray, checked_order
from flexfmu.trajectories.trajectory import Trajectory


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
        motion = Jet.from_derivatives(self.joints.evaluate(time, checked_order(order), side))
        q11, q21 = (Jet(motion.coefficients[:, :, i]) for i in (0, 1))
        return np.stack([jet.derivatives() for jet in self.kinematics.end_effector(q11, q21)], axis=-1)
