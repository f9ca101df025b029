"""Working and assembly modes of the rigid five-bar mechanism as plain numbers; needs nothing but the scene's lengths."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flexfmu.model.scene import Mechanism

WORKING_MODES: dict[str, tuple[int, int]] = {
    "elbows-out": (+1, -1),
    "elbows-in": (-1, +1),
    "left": (+1, +1),
    "right": (-1, -1),
}
"""Signs of acos in q_1 = angle(X - B_1) ± acos(..), q_2 = angle(X - B_2) ± acos(..)."""

Point = tuple[float, float]


def bases(mechanism: Mechanism) -> tuple[Point, Point]:
    """The two fixed joints B_1 and B_2 [m]."""
    a = mechanism.base_half_distance
    return (-a, 0.0), (a, 0.0)


def elbow(base: Point, position: Point, proximal: float, distal: float, sign: int) -> Point:
    """The elbow of one leg for an end-effector position, all in m.

    Raises:
        ValueError: the leg can't reach the position.
    """
    dx, dy = position[0] - base[0], position[1] - base[1]
    distance = math.hypot(dx, dy)
    nearest, farthest = abs(proximal - distal), proximal + distal
    if not nearest < distance < farthest:
        raise ValueError(
            f"the position ({position[0]}, {position[1]}) m is {distance:.6g} m from the base at ({base[0]}, {base[1]}) m, "
            f"but a leg reaches {nearest:.6g} to {farthest:.6g} m: move the path or change the link lengths"
        )
    cosine = (proximal**2 + distance**2 - distal**2) / (2.0 * proximal * distance)
    angle = math.atan2(dy, dx) + sign * math.acos(cosine)
    return base[0] + proximal * math.cos(angle), base[1] + proximal * math.sin(angle)


def assembly_side(elbow1: Point, elbow2: Point, position: Point) -> float:
    """Positive where the position lies left of the directed line elbow 1 → elbow 2, negative where right [m²]."""
    (x1, y1), (x2, y2) = elbow1, elbow2
    return (x2 - x1) * (position[1] - y1) - (y2 - y1) * (position[0] - x1)


def check_start_pose(mechanism: Mechanism, start: Point) -> None:
    """Refuse modes that contradict each other at the start pose.

    Raises:
        ValueError: the start can't be reached, or the assembly mode is the other one there.
    """
    signs = WORKING_MODES[mechanism.working_mode]
    lengths = mechanism.proximal.length, mechanism.distal.length
    elbow1, elbow2 = (elbow(base, start, *lengths, sign) for base, sign in zip(bases(mechanism), signs, strict=True))
    actual = "left" if assembly_side(elbow1, elbow2, start) > 0.0 else "right"
    if actual != mechanism.assembly_mode:
        raise ValueError(
            f"`mechanism.assembly_mode` must be '{actual}' for `working_mode` = '{mechanism.working_mode}' at the start pose "
            f"({start[0]}, {start[1]}) m, got '{mechanism.assembly_mode}'"
        )
