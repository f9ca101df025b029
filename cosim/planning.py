"""From a scene to the planned motion: path, task-space trajectory and joint trajectory."""

from __future__ import annotations

from dataclasses import dataclass

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene import Scene
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.trajectory import TaskTrajectory


@dataclass(frozen=True)
class MotionPlan:
    """The motion that a scene asks for; standstill at the end point during the dwell.

    Attributes:
        scene: where it comes from.
        task: end-effector trajectory of the rigid mechanism in x, y [m].
        kinematics: the mechanism's rigid inverse kinematics.
        joints: joint trajectory in q11, q21 [rad].
    """

    scene: Scene
    task: TaskTrajectory
    kinematics: RigidKinematics
    joints: JointTrajectory

    @property
    def duration(self) -> float:
        """Duration of the motion T [s], without the dwell."""
        return self.task.duration

    @property
    def stop_time(self) -> float:
        """End of the simulation [s]: motion and dwell."""
        return self.task.duration + self.scene.trajectory.dwell


def plan(scene: Scene) -> MotionPlan:
    """Plan the scene's motion and check it along the whole path.

    Raises:
        TrajectoryError: the path is not feasible, leaves the workspace or comes too close to a singularity.
    """
    raise NotImplementedError
