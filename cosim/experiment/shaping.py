"""A planned motion with an input shaper: on the joint references, or on the motion along the path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.model.kinematics import RigidForwardKinematics
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.joint import JointTrajectory, check_margins
from flexfmu.trajectories.shapers.deviation import path_deviation
from flexfmu.trajectories.shapers.end_effector import EndEffectorTrajectory
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.shapers.shaped import ShapedTrajectory
from flexfmu.trajectories.shapers.shaped_profile import shape_along_path
from flexfmu.trajectories.trajectory import TaskTrajectory


def shape_joints(motion: MotionPlan, sequence: ImpulseSequence) -> MotionPlan:
    """The motion with shaped joint references; the rigid end effector leaves the path a little.

    Raises:
        TrajectoryError: the end effector comes too near to a singularity or to the workspace's boundary.
    """
    joints = ShapedTrajectory(motion.joints, sequence)
    task = EndEffectorTrajectory(joints, RigidForwardKinematics(motion.scene.mechanism))
    check_margins(task, motion.kinematics)
    return replace(motion, task=task, joints=joints)


def shape_path(motion: MotionPlan, sequence: ImpulseSequence) -> MotionPlan:
    """The motion along its path with shaped s(t), once more where it is shaped so already; the rigid end effector keeps to the path.

    Raises:
        TrajectoryError: negative impulses make the motion go backwards, or the joint references are shaped already.
    """
    if not isinstance(motion.task, TaskTrajectory):
        raise TrajectoryError("shaped joint references leave the path: shape the motion along the path first")
    task = shape_along_path(motion.task, sequence)
    return replace(motion, task=task, joints=JointTrajectory(task, motion.kinematics))


APPLICATIONS: Mapping[str, Callable[[MotionPlan, ImpulseSequence], MotionPlan]] = {
    "joints": shape_joints,
    "path": shape_path,
}
"""What is shaped → how."""


def deviation(motion: MotionPlan) -> float:
    """Largest distance [m] of the rigid end effector from the scene's path."""
    return path_deviation(motion.task, motion.along_path.path)
