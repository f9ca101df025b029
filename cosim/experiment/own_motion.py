"""Plans motions that a user's object gives in place of the scene's path and profile."""

from __future__ import annotations

from math import dist

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.loop import Loop
from flexfmu.cosim.experiment.planning import MotionPlan, with_references
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.model.kinematics import RigidForwardKinematics, RigidKinematics
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.own import OwnMotion, as_trajectory, coordinates_of
from flexfmu.trajectories.shapers.shaped_joints import EndEffectorTrajectory
from flexfmu.trajectories.trajectory import Trajectory

SAME_ANGLE, SAME_PLACE = 1e-9, 1e-9
"""Joint angles [rad] and places [m] that differ by less are the same."""


def plan_own(scene: Scene, own: OwnMotion | Trajectory) -> MotionPlan:
    """Plan a motion that a user's object gives, instead of that of the scene's path, and check it all along.

    Args:
        scene: the scene; its start point and duration become those of the motion, its path and profile play no part.
        own: see `flexfmu.trajectories.own.as_trajectory`.

    Raises:
        TrajectoryError: the motion can't be used, see `as_trajectory`, leaves the workspace, comes too close to a singularity,
            its joint angles aren't those of the scene's working mode, or the scene's motion is a table that starts elsewhere.
        SceneError: the scene's modes don't fit the start of the motion.
    """
    # motion of the end effector, given or by forward kinematics
    given, kinematics = as_trajectory(own), RigidKinematics(scene.mechanism)
    by_joints = coordinates_of(own) == "joints"
    task = EndEffectorTrajectory(given, RigidForwardKinematics(scene.mechanism)) if by_joints else given
    start = tuple(task.evaluate(0.0, 0)[0, 0].tolist())
    if isinstance(scene.trajectory, TrajectorySection):
        scene = scene.replace({"trajectory.start": start})
    elif dist(start, scene.start) > SAME_PLACE:
        raise TrajectoryError(
            f"scene {scene.name} has a motion from a table, which starts at {_place(scene.start)}, the own motion at {_place(start)}: "
            f"let it start there, or give a scene with a path"
        )
    scene = scene.replace({"trajectory.duration": given.duration})
    joints: Trajectory = JointTrajectory(task, kinematics)
    # joint angles as given, which have to be those of the robot's start pose
    if by_joints:
        angles, wanted = (each.evaluate(0.0, 0)[0, 0] for each in (given, joints))
        if abs(angles - wanted).max() > SAME_ANGLE:
            raise TrajectoryError(
                f"the own motion starts at joint angles {angles.round(6).tolist()} rad, but the scene's modes have the end "
                f"effector there with {wanted.round(6).tolist()} rad: give these, or change `mechanism.working_mode`"
            )
        joints = given
    planned = MotionPlan(scene, task, kinematics, task, joints, source=f"own motion {type(own).__name__}")
    # a motion of the joints is taken as it is
    return planned if by_joints else with_references(planned)


def own_loop(scene: Scene, own: OwnMotion | Trajectory) -> Loop:
    """Return the loop of a scene with an own motion, to which its shapers and cycles apply.

    Raises:
        InputError: the scene leaves the choice of effects open, or a slave can't be made or connected.
        TrajectoryError, SceneError: as for `plan_own`.
    """
    if scene.effects.select is not None:
        raise InputError(
            f'scene {scene.name} has `select = "auto"`, which chooses the effects for the scene\'s own path: name the effects '
            "for an own motion, for example those that `flexfmu effects` prints"
        )
    planned = plan_own(scene, own)
    return loop_of(planned.scene, own=planned)


def _place(point: tuple[float, ...]) -> str:
    """A place, for messages."""
    return f"({point[0]:.9g}, {point[1]:.9g}) m"
