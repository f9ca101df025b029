"""Motions from tables: splines through the rows, checked against the mechanism row by row and between them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.assembly import end_effector, motor_angles
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.motion import TableSection
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.joint import EndEffectorTrajectory, JointTrajectory, check_margins
from flexfmu.trajectories.piecewise import PiecewisePolynomial
from flexfmu.trajectories.table import MotionTable
from flexfmu.trajectories.trajectory import Trajectory


def table_motion(section: TableSection, mechanism: Mechanism) -> tuple[Trajectory, Trajectory]:
    """The motion of a table: of the rigid end effector, x and y [m], and of the joints, q11 and q21 [rad].

    Raises:
        TrajectoryError: a row, or the motion between rows, is out of reach or too close to a singularity.
    """
    table = section.table
    try:
        task, joints = _checked(table, section.degree, section.noise, mechanism, None)
    except TrajectoryError:
        # the error names the instant of the motion
        task, joints = _checked(table, section.degree, section.noise, mechanism, section.duration)
    if section.duration == table.duration:
        return task, joints
    if isinstance(joints, JointTrajectory):
        assert isinstance(task, PiecewisePolynomial)
        motion = task.with_duration(section.duration)
        return motion, joints.timed(motion)
    assert isinstance(joints, PiecewisePolynomial)
    return _from_joints(joints.with_duration(section.duration), mechanism)


@lru_cache(maxsize=64)
def _checked(
    table: MotionTable, degree: int | None, noise: float | None, mechanism: Mechanism, duration: float | None
) -> tuple[Trajectory, Trajectory]:
    """The motion with its checks, cached, since durations don't change where it goes; None for the table's own duration."""
    motion = table.trajectory(degree, noise)
    motion = motion if duration is None else motion.with_duration(duration)
    if table.coordinates == "end-effector":
        _check_rows(table, table.derivatives[0], mechanism)
        return motion, JointTrajectory(motion, RigidKinematics(mechanism))
    _check_rows(table, _positions(table, mechanism), mechanism)
    task, joints = _from_joints(_in_turn(motion, mechanism), mechanism)
    try:
        check_margins(task, RigidKinematics(mechanism))
    except TrajectoryError as error:
        # between rows the elbows may come too far apart for forward kinematics
        message = str(error)
        if "jet" in message:
            message = "the elbows are too far apart between two rows: give more rows, or a lower `degree`"
        raise TrajectoryError(f"{table.source}: {message}") from None
    return task, joints


def _in_turn(joints: PiecewisePolynomial, mechanism: Mechanism) -> PiecewisePolynomial:
    """The motion of the joints, by whole turns in the range of the robot's own angles at the start."""
    start = np.array(joints.rest[0])
    x, y = end_effector(mechanism, (float(start[0]), float(start[1])))
    turns = np.round((np.array(motor_angles(mechanism, (x, y))) - start) / (2.0 * np.pi))
    if not turns.any():
        return joints
    coefficients = joints.coefficients.copy()
    coefficients[0] += 2.0 * np.pi * turns
    return replace(joints, coefficients=coefficients)


def _from_joints(joints: PiecewisePolynomial, mechanism: Mechanism) -> tuple[Trajectory, Trajectory]:
    """The motion of the end effector by forward kinematics, and that of the joints."""
    return EndEffectorTrajectory(joints, RigidKinematics(mechanism)), joints


def _positions(table: MotionTable, mechanism: Mechanism) -> RealArray:
    """Positions of the end effector at the rows of a table of joints, (N, 2) [m].

    Raises:
        TrajectoryError: at a row the elbows are too far apart.
    """
    positions = []
    for line, (first, second) in zip(table.lines, table.derivatives[0].tolist(), strict=True):
        try:
            positions.append(end_effector(mechanism, (first, second)))
        except ValueError as error:
            raise TrajectoryError(f"{table.source}, line {line}: {error}") from None
    return np.array(positions)


def _check_rows(table: MotionTable, positions: RealArray, mechanism: Mechanism) -> None:
    """Check that the end effector keeps its margins at the rows' positions (N, 2) [m].

    Raises:
        TrajectoryError: it doesn't; the message names the first such row.
    """
    # an undefined margin counts as too small; the first finite one is the cause
    for margin in RigidKinematics(mechanism).margins(positions):
        bad = np.flatnonzero(~(margin.values >= margin.required))
        if bad.size:
            row, unit = bad[0], "" if margin.unit == "1" else f" {margin.unit}"
            x, y = positions[row]
            raise TrajectoryError(
                f"{table.source}, line {table.lines[row]}: {margin.name} is {margin.values[row]:.6g}{unit} at (x, y) = "
                f"({x:.6g}, {y:.6g}) m; it must be at least {margin.required:.6g}{unit} along the whole path: move the path or "
                f"change the mechanism"
            )
