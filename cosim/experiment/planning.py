"""From a scene to the planned motion: path, task-space trajectory and joint trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.blends import BLENDS
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.profiles import PROFILES
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory


@dataclass(frozen=True)
class Repetition:
    """A motion that is made there and back, again and again.

    Attributes:
        once: the motion.
        cycles: how often.
        period: length of a cycle [s].
    """

    once: MotionPlan
    cycles: int
    period: float


@dataclass(frozen=True)
class MotionPlan:
    """The motion that a scene asks for; standstill at the end point during the dwell.

    Attributes:
        scene: where it comes from.
        along_path: the scene's own motion along its path, before any shaping, in x, y [m].
        kinematics: the mechanism's rigid inverse kinematics.
        task: end-effector trajectory of the rigid mechanism in x, y [m].
        joints: joint trajectory in q11, q21 [rad].
        repetition: what is repeated, and how often; None for a motion that is made once.
    """

    scene: Scene
    along_path: TaskTrajectory
    kinematics: RigidKinematics
    task: Trajectory
    joints: Trajectory
    repetition: Repetition | None = None

    @property
    def once(self) -> MotionPlan:
        """The motion itself, without its repetitions."""
        return self if self.repetition is None else self.repetition.once

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
    section = scene.trajectory
    corner = section.blend.kind, section.blend.height, section.blend.width
    path = _path(section.start, section.lift, section.height, section.width, corner)
    profile = PROFILES[section.profile.kind].make(**section.profile.parameters)
    task = TaskTrajectory(path, profile, section.duration)
    kinematics = RigidKinematics(scene.mechanism)
    return MotionPlan(scene, task, kinematics, task, JointTrajectory(task, kinematics))


@lru_cache(maxsize=64)
def _path(start: Point, lift: Point, height: float, width: float, corner: tuple[str, float, float]) -> PickAndPlacePath:
    """The path; equal ones share their table of arc lengths."""
    kind, *extent = corner
    return PickAndPlacePath(start, lift, height, width, BLENDS[kind].make(*extent))
