"""Plans the motion of a scene: path, task-space trajectory, joint trajectory, and their shaping.

A motion with standstill before and after it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import dist
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.showing import Rows, shown_unit
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.assembly import end_effector
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.motion import TableSection, TrajectorySection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.errors import TrajectoryError, times
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.joint import EndEffectorTrajectory, JointTrajectory, check_margins
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.profiles import PROFILES
from flexfmu.trajectories.trajectory import HasLimits, TaskTrajectory, Trajectory, limits, merged

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from flexfmu.model.reference_design.inverse_dynamics import FlexibleReferences
    from flexfmu.trajectories.shapers.sequence import ImpulseSequence
    from flexfmu.trajectories.sources import OwnMotion


@dataclass(frozen=True)
class Standstill(HasLimits):
    """A motion that begins after a standstill, and ends with one.

    Attributes:
        motion: the motion.
        time: duration of each standstill [s].
    """

    motion: Trajectory
    time: float

    @property
    def duration(self) -> float:
        """Duration with both standstills [s]."""
        return self.motion.duration + 2.0 * self.time

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Start and end [s], and the delayed breakpoints of the motion."""
        return merged([0.0, self.duration], [self.time + point for point in self.motion.breakpoints])

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `flexfmu.trajectories.trajectory.HasLimits`."""
        return limits(self.motion, times(time) - self.time, left, order)


Law = tuple[str, tuple[tuple[str, float | tuple[float, ...]], ...]]
"""Kind and parameters of a motion profile."""


@dataclass(frozen=True)
class Repetition:
    """Repetition of a motion, forward and reverse.

    Attributes:
        once: plan of the single motion.
        cycles: number of cycles.
        period: duration of a cycle [s].
    """

    once: MotionPlan
    cycles: int
    period: float


class Tabulated:
    """A trajectory that keeps its one-sided limits at the last instants, for runs with the same ones."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory, self.duration, self.breakpoints = trajectory, trajectory.duration, trajectory.breakpoints
        self._table: tuple[RealArray, NDArray[np.bool_], RealArray] | None = None
        self.evaluate = trajectory.evaluate

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `flexfmu.trajectories.trajectory.HasLimits`; callers share the result and don't write to it."""
        instants = np.asarray(time, dtype=float)
        if self._table is not None and len(self._table[2]) == order + 1:
            known, sides, found = self._table
            if np.array_equal(known, instants) and np.array_equal(sides, left):
                return found
        found = limits(self._trajectory, instants, left, order)
        self._table = instants, left, found
        return found


DERIVATIVES = {"position": "", "velocity": "/s", "acceleration": "/s2"}
"""Derivatives of a motion by their order, with what their unit has behind that of the position."""

SAME_ANGLE, SAME_PLACE = 1e-9, 1e-9
"""Joint angles [rad] and places [m] that differ by less are the same."""

PLANNED_WITH = ("base_half_distance", "proximal.length", "distal.length")
"""Parameters of the robot's FMU that its motion depends on as well, keys of the section ``mechanism``."""

POSES = 401
"""Number of poses at which a motion is examined."""

SPEEDS = 500
"""Number of instants among which a motion's largest joint velocity is looked for."""


@dataclass(frozen=True, repr=False)
class MotionPlan(Rows):
    """The planned motion of a scene; during the dwell it stands still at the end point.

    Its rows are `POSES` equidistant instants of the single motion, without repetitions and dwell.

    Attributes:
        scene: the scene.
        along_path: the scene's motion before shaping, in x, y [m]; a `TaskTrajectory` where the scene has path and profile.
        kinematics: the mechanism's rigid inverse kinematics.
        task: motion of the end effector in x, y [m]: that of the rigid mechanism, or with references for the flexible robot
            what its end effector shall do.
        joints: joint trajectory in q11, q21 [rad].
        repetition: single motion and number of cycles; None for a motion without repetition.
        source: what gives the motion, in a few words; empty for path and profile of the scene.
        rigid: the same motion with references for the rigid robot; None where these are them.
        design: references for the flexible robot; None where they are for the rigid one.
    """

    scene: Scene
    along_path: Trajectory
    kinematics: RigidKinematics
    task: Trajectory
    joints: Trajectory
    repetition: Repetition | None = None
    source: str = ""
    rigid: MotionPlan | None = None
    design: FlexibleReferences | None = None

    def __repr__(self) -> str:
        """Return a line: whose motion, and how long it and the dwell take."""
        cycles = "" if self.repetition is None else f", {self.repetition.cycles} cycles"
        return (
            f"MotionPlan of {self.scene.name}: {self.duration:g} s of motion{cycles}, "
            f"{self.stop_time - self.duration:g} s of dwell"
        )

    row_name: ClassVar[str] = "time"

    def _sampled(self) -> Recording:
        """Joints and end effector with their derivatives at `POSES` instants."""
        once = self.once
        time = np.linspace(0.0, once.duration, POSES)
        columns = {}
        for trajectory, names, unit in (
            (once.joints, ("joint1", "joint2"), "rad"),
            (once.task, ("end_effector.x", "end_effector.y"), "m"),
        ):
            found = trajectory.evaluate(time, len(DERIVATIVES) - 1, "left")
            for order, (derivative, per) in enumerate(DERIVATIVES.items()):
                for k, name in enumerate(names):
                    columns[f"{name}.{derivative}"] = Column(unit + per, found[order, :, k])
        return Recording(time, columns)

    def rows(self) -> list[dict[str, float]]:
        """Joint angles, end effector, their velocities and accelerations at each instant, in SI units."""
        recording = self._sampled()
        table = {"time": recording.time} | {name: column.values for name, column in recording.items()}
        return [
            dict(zip(table, row, strict=True)) for row in zip(*(each.tolist() for each in table.values()), strict=True)
        ]

    def row_units(self) -> Mapping[str, str]:
        """Column → unit; that of a largest value too."""
        return self._sampled().units

    def shown_rows(self) -> list[dict[str, Any]]:
        """Smallest and largest value of each signal."""
        return [
            {"signal": f"{name} [{shown_unit(column.unit)}]", "smallest": min(values), "largest": max(values)}
            for name, column in self._sampled().items()
            for values in [column.values.tolist()]
        ]

    def plot(self) -> Figure:
        """Joint angles with their velocities and accelerations over time."""
        return self._sampled().plot("joint*", f"{self.scene.name}: joint references")

    @property
    def once(self) -> MotionPlan:
        """The plan of the single motion, without repetitions."""
        return self if self.repetition is None else self.repetition.once

    @property
    def profiled(self) -> TaskTrajectory:
        """The scene's motion as path and profile.

        Raises:
            TrajectoryError: it has none, since it comes from a table or from an own class.
        """
        if not isinstance(self.along_path, TaskTrajectory):
            raise TrajectoryError(f"{self.source} has no profile along a path")
        return self.along_path

    @property
    def duration(self) -> float:
        """Duration of the motion T [s], without the dwell."""
        return self.task.duration

    @property
    def deviation(self) -> float:
        """Largest distance [m] of the rigid end effector from the scene's path, which shaped joint references leave."""
        from flexfmu.trajectories.shapers.sequence import path_deviation

        reference = self.along_path
        return path_deviation(self.task, reference.path if isinstance(reference, TaskTrajectory) else reference)

    @cached_property
    def top_speed(self) -> float:
        """Largest velocity of a joint [rad/s] among `SPEEDS` instants of the motion."""
        return float(abs(self.joints.evaluate(np.linspace(0.0, self.joints.duration, SPEEDS), 1)[1]).max())

    @property
    def stop_time(self) -> float:
        """End of the simulation [s]: motion and dwell."""
        return self.task.duration + self.scene.trajectory.dwell

    @cached_property
    def end_pose(self) -> tuple[RealArray, RealArray]:
        """Joint angles (2,) [rad] and the rigid robot's end-effector position (2,) [m] at the end of the motion."""
        end = np.array([self.duration])
        joints, position = (each.evaluate(end, 0, side="left")[0, 0] for each in (self.joints, self.task))
        return joints, position if self.design is None else self._rigid_position(joints)

    @property
    def start(self) -> Point:
        """Position x, y of the rigid end effector at the start of the motion [m]."""
        if self.design is None:
            return self.scene.start
        x, y = self._rigid_position(self.joints.evaluate(0.0, 0, "left")[0, 0]).tolist()
        return x, y

    def _rigid_position(self, joints: RealArray) -> RealArray:
        return np.array(end_effector(self.scene.mechanism, (float(joints[0]), float(joints[1]))))

    @cached_property
    def poses(self) -> RealArray:
        """(`POSES`, 2) joint angles [rad] at equidistant instants of the motion, both ends included."""
        instants = np.linspace(0.0, self.once.duration, POSES)
        return np.asarray(self.once.joints.evaluate(instants, 0, "left")[0])

    @cached_property
    def tabulated(self) -> tuple[Tabulated, Tabulated]:
        """``task`` and ``joints``, each of which keeps its derivatives at the instants that were asked for last."""
        return Tabulated(self.task), Tabulated(self.joints)


def plan(scene: Scene) -> MotionPlan:
    """Plan the scene's motion and check it along the whole path, with references for the rigid or the flexible robot.

    Raises:
        TrajectoryError: the path is not feasible, leaves the workspace or comes too close to a singularity, or no references
            make the flexible end effector follow it.
    """
    return with_references(plan_rigid(scene))


def with_references(motion: MotionPlan) -> MotionPlan:
    """The motion with references as its scene wants them: for the rigid robot, or for the flexible one.

    While a scene leaves the choice of effects open, there is no flexible robot yet, and the references are for the rigid one.

    Raises:
        TrajectoryError: no references make the flexible end effector follow the motion.
    """
    scene, section = motion.scene, motion.scene.trajectory.references
    if section is None or scene.effects.select is not None:
        return motion
    from flexfmu.model.reference_design.inverse_dynamics import LEAD, flexible_references  # which few scenes need

    # the joints start before the end effector, and stop after it
    design = flexible_references(scene, motion.task, motion.joints, section.knot_spacing)
    return replace(motion, task=Standstill(motion.task, LEAD), joints=design.joints, rigid=motion, design=design)


def plan_rigid(scene: Scene) -> MotionPlan:
    """Plan the scene's motion with references for the rigid robot.

    Raises:
        TrajectoryError: as for `plan`.
    """
    section = scene.trajectory
    if isinstance(section, TableSection):
        from flexfmu.cosim.experiment.table_motion import table_motion  # which few scenes need

        task, joints = table_motion(section, scene.mechanism)
        source = section.table.description(section.degree, section.noise)
        return MotionPlan(scene, task, RigidKinematics(scene.mechanism), task, joints, source=source)
    path = section.path
    law = section.profile.kind, tuple(section.profile.parameters.items())
    try:
        joints = _motion_in_a_second(path, law, scene.mechanism)
    except TrajectoryError:
        # the error names the instant of the motion
        joints = _motion(path, law, scene.mechanism, section.duration)
    # the motion with its duration
    motion = cast(TaskTrajectory, joints.task).with_duration(section.duration)
    return MotionPlan(scene, motion, cast(RigidKinematics, joints.kinematics), motion, joints.timed(motion))


def plan_own(scene: Scene, own: OwnMotion | Trajectory) -> MotionPlan:
    """Plan a motion that a user's object gives, instead of that of the scene's path, and check it all along.

    Args:
        scene: the scene; its start point and duration become those of the motion, its path and profile play no part.
        own: see `flexfmu.trajectories.sources.as_trajectory`.

    Raises:
        TrajectoryError: the motion can't be used, see `as_trajectory`, leaves the workspace, comes too close to a singularity,
            its joint angles aren't those of the scene's working mode, or the scene's motion is a table that starts elsewhere.
        SceneError: the scene's modes don't fit the start of the motion.
    """
    from flexfmu.trajectories.sources import as_trajectory, coordinates_of  # which few scenes need

    # motion of the end effector, given or by forward kinematics
    given, kinematics = as_trajectory(own), RigidKinematics(scene.mechanism)
    by_joints = coordinates_of(own) == "joints"
    task = EndEffectorTrajectory(given, kinematics) if by_joints else given
    start = tuple(task.evaluate(0.0, 0)[0, 0].tolist())
    if isinstance(scene.trajectory, TrajectorySection):
        scene = scene.replace({"trajectory.start": start})
    elif dist(start, scene.start) > SAME_PLACE:
        raise TrajectoryError(
            "scene {} has a motion from a table, which starts at ({:.9g}, {:.9g}) m, the own motion at ({:.9g}, {:.9g}) m: "
            "let it start there, or give a scene with a path".format(scene.name, *scene.start, *start)
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


def _motion(path: PickAndPlacePath, law: Law, mechanism: Mechanism, duration: float) -> JointTrajectory:
    """The joint trajectory by inverse kinematics, which checks the margins along the path."""
    kind, parameters = law
    motion = TaskTrajectory(path, PROFILES[kind].make(**dict(parameters)), duration)
    return JointTrajectory(motion, RigidKinematics(mechanism))


@lru_cache(maxsize=64)
def _motion_in_a_second(path: PickAndPlacePath, law: Law, mechanism: Mechanism) -> JointTrajectory:
    """The motion with a duration of 1 s, cached, since durations don't change where it goes."""
    return _motion(path, law, mechanism, 1.0)


def shape_joints(motion: MotionPlan, sequence: ImpulseSequence) -> MotionPlan:
    """The motion with shaped joint references; the rigid end effector leaves the path a little.

    Raises:
        TrajectoryError: the end effector comes too near to a singularity or to the workspace's boundary.
    """
    if motion.design is not None:
        raise TrajectoryError(
            "shaped joint references would no longer be those of the flexible robot: shape the motion along the path "
            '(`apply = "path"`), or leave out `trajectory.references`'
        )
    from flexfmu.trajectories.shapers.sequence import ShapedTrajectory

    joints = ShapedTrajectory(motion.joints, sequence)
    task = EndEffectorTrajectory(joints, RigidKinematics(motion.scene.mechanism))
    check_margins(task, motion.kinematics)
    return replace(motion, task=task, joints=joints)


def shape_path(motion: MotionPlan, sequence: ImpulseSequence) -> MotionPlan:
    """The motion with shaped s(t) along its path, in addition to earlier shaping; the rigid end effector stays on the path.

    Raises:
        TrajectoryError: negative impulses make the motion go backwards, or the joint references are shaped already.
    """
    if motion.rigid is not None:
        return with_references(shape_path(motion.rigid, sequence))
    from flexfmu.trajectories.shapers.sequence import shape_along_path

    if not isinstance(motion.task, TaskTrajectory):
        if motion.task is motion.along_path:
            raise TrajectoryError(f"{motion.source} has no profile along a path: shape the joint references")
        raise TrajectoryError("shaped joint references leave the path: shape the motion along the path first")
    task = shape_along_path(motion.task, sequence)
    return replace(motion, task=task, joints=JointTrajectory(task, motion.kinematics))


APPLICATIONS: Mapping[str, Callable[[MotionPlan, ImpulseSequence], MotionPlan]] = {
    "joints": shape_joints,
    "path": shape_path,
}
"""Place of shaping → function that applies an impulse sequence there."""
