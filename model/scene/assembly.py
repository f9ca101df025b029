"""Inverse kinematics of the rigid five-bar for single points, with its working and assembly modes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from flexfmu.model.scene.mechanism import Mechanism

if TYPE_CHECKING:
    from flexfmu.trajectories.curves import Point

WORKING_MODES: dict[str, tuple[int, int]] = {
    "elbows-out": (+1, -1),
    "elbows-in": (-1, +1),
    "left": (+1, +1),
    "right": (-1, -1),
}
"""Signs of acos in q_1 = angle(X - B_1) ± acos(..), q_2 = angle(X - B_2) ± acos(..)."""


def bases(mechanism: Mechanism) -> tuple[Point, Point]:
    """The two fixed joints B_1 and B_2 [m]."""
    a = mechanism.base_half_distance
    return (-a, 0.0), (a, 0.0)


def motor_angle(base: Point, position: Point, proximal: float, distal: float, sign: int) -> float:
    """The motor angle [rad] of one leg for an end-effector position, lengths in m.

    Raises:
        ValueError: the leg can't reach the position.
    """
    dx, dy = position[0] - base[0], position[1] - base[1]
    distance = math.hypot(dx, dy)
    # outside this range the two circles don't intersect
    nearest, farthest = abs(proximal - distal), proximal + distal
    if not nearest < distance < farthest:
        raise ValueError(
            f"the position ({position[0]}, {position[1]}) m is {distance:.6g} m from the base at ({base[0]}, {base[1]}) m, "
            f"but a leg reaches {nearest:.6g} to {farthest:.6g} m: move the path or change the link lengths"
        )
    # law of cosines at the base
    cosine = (proximal**2 + distance**2 - distal**2) / (2.0 * proximal * distance)
    return math.atan2(dy, dx) + sign * math.acos(cosine)


def elbow(base: Point, angle: float, proximal: float) -> Point:
    """The elbow of one leg for a motor angle [rad], lengths in m."""
    return base[0] + proximal * math.cos(angle), base[1] + proximal * math.sin(angle)


def motor_angles(mechanism: Mechanism, position: Point) -> tuple[float, float]:
    """Motor angles (q11, q21) [rad] that put the end effector at `position` [m] in the working mode.

    Raises:
        ValueError: a leg can't reach the position.
    """
    lengths = mechanism.proximal.length, mechanism.distal.length
    (base1, base2), (sign1, sign2) = bases(mechanism), WORKING_MODES[mechanism.working_mode]
    return motor_angle(base1, position, *lengths, sign1), motor_angle(base2, position, *lengths, sign2)


def elbows(mechanism: Mechanism, position: Point) -> tuple[Point, Point]:
    """Elbow points [m] for an end-effector position [m].

    Raises:
        ValueError: a leg can't reach the position."""
    (base1, base2), (angle1, angle2) = bases(mechanism), motor_angles(mechanism, position)
    return elbow(base1, angle1, mechanism.proximal.length), elbow(base2, angle2, mechanism.proximal.length)


def assembly_side(elbow1: Point, elbow2: Point, position: Point) -> float:
    """Positive where the position lies left of the directed line elbow 1 → elbow 2, negative where right [m²]."""
    (x1, y1), (x2, y2) = elbow1, elbow2
    return (x2 - x1) * (position[1] - y1) - (y2 - y1) * (position[0] - x1)


def check_start_pose(mechanism: Mechanism, start: Point) -> None:
    """Check that working mode and assembly mode agree at the start pose.

    Raises:
        ValueError: a leg can't reach the start, or the robot has the other assembly mode there.
    """
    actual = "left" if assembly_side(*elbows(mechanism, start), start) > 0.0 else "right"
    if actual != mechanism.assembly_mode:
        raise ValueError(
            f"`mechanism.assembly_mode` must be '{actual}' for `working_mode` = '{mechanism.working_mode}' at the start pose "
            f"({start[0]}, {start[1]}) m, got '{mechanism.assembly_mode}'"
        )


def end_effector(mechanism: Mechanism, angles: tuple[float, float]) -> Point:
    """The end-effector position [m] of the assembly mode for motor angles (q11, q21) [rad].

    Raises:
        ValueError: the elbows are too far apart for the distal links.
    """
    (x1, y1), (x2, y2) = (
        elbow(base, angle, mechanism.proximal.length) for base, angle in zip(bases(mechanism), angles, strict=True)
    )
    dx, dy = x2 - x1, y2 - y1
    apart, reach = math.hypot(dx, dy), 2.0 * mechanism.distal.length
    if not 0.0 < apart < reach:
        raise ValueError(
            f"the elbows are {apart:.6g} m apart at q11 = {angles[0]:g} rad, q21 = {angles[1]:g} rad, but the distal links "
            f"reach above 0 m and below {reach:.6g} m: move the motion or change the link lengths"
        )
    # on the perpendicular bisector of the elbows
    side = 1.0 if mechanism.assembly_mode == "left" else -1.0
    height = side * math.sqrt((mechanism.distal.length / apart) ** 2 - 0.25)
    return 0.5 * (x1 + x2) - height * dy, 0.5 * (y1 + y2) + height * dx


def check_working_mode(mechanism: Mechanism, angles: tuple[float, float], position: Point) -> None:
    """Check that motor angles (q11, q21) [rad] are those of the working mode at an end-effector position [m].

    Raises:
        ValueError: they are those of another working mode.
    """
    # a leg's angle is ahead of that of the line from base to end effector, or behind it
    signs = []
    for (base_x, base_y), angle in zip(bases(mechanism), angles, strict=True):
        line = math.atan2(position[1] - base_y, position[0] - base_x)
        signs.append(1 if math.sin(angle - line) > 0.0 else -1)
    actual = next(mode for mode, each in WORKING_MODES.items() if each == tuple(signs))
    if actual != mechanism.working_mode:
        raise ValueError(
            f"`mechanism.working_mode` must be '{actual}' for q11 = {angles[0]:g} rad, q21 = {angles[1]:g} rad at the start, "
            f"got '{mechanism.working_mode}'"
        )
