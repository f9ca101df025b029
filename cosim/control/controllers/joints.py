"""Variables, gains, torque limits and equations that all joint controllers share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Literal

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Equations, Vector, split
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.symbolic import Variable

JOINTS = ("joint1", "joint2")
"""Actuated joints of the five-bar."""

JointQuantity = Literal["position", "velocity", "acceleration"]
UNITS: dict[JointQuantity, str] = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s2"}

PerJoint = float | Sequence[float]
"""One number for all joints, or one for each."""


def references(joints: Sequence[str], *kinds: JointQuantity) -> list[Variable]:
    """Return the inputs ``joint1.reference.position`` and so on, those of the first kind first."""
    return [
        Variable(f"{joint}.reference.{kind}", UNITS[kind], f"Reference {kind} of {joint}", "input", 0.0)
        for kind in kinds
        for joint in joints
    ]


def measurements(joints: Sequence[str], *kinds: JointQuantity) -> list[Variable]:
    """Return the inputs ``joint1.position`` and so on, those of the first kind first."""
    return [
        Variable(f"{joint}.{kind}", UNITS[kind], f"Measured {kind} of {joint}", "input", 0.0)
        for kind in kinds
        for joint in joints
    ]


def feedforwards(joints: Sequence[str]) -> list[Variable]:
    """Return the inputs ``joint1.feedforward``: torques that are added before the limits."""
    return [
        Variable(f"{joint}.feedforward", "N.m", f"Torque added to that of the controller of {joint}", "input", 0.0)
        for joint in joints
    ]


def feedforward_outputs(joints: Sequence[str], what: str) -> list[Variable]:
    """Return the outputs ``joint1.feedforward`` of a slave that calculates feedforward torques."""
    return [Variable(f"{joint}.feedforward", "N.m", f"{what} of {joint}", "output") for joint in joints]


def torques(joints: Sequence[str]) -> list[Variable]:
    """Return the outputs ``joint1.torque``."""
    return [Variable(f"{joint}.torque", "N.m", f"Torque of {joint}, counter-clockwise", "output") for joint in joints]


def gains(joints: Sequence[str], name: str, values: PerJoint, unit: str, what: str) -> list[Variable]:
    """Return the tunable parameters ``joint1.<name>``, zero or positive.

    Raises:
        InputError: there isn't one finite, non-negative value for each joint.
    """
    return [
        Variable(f"{joint}.{name}", unit, f"{what} of {joint}", "parameter", value, minimum=0.0, tunable=True)
        for joint, value in zip(joints, per_joint(joints, name, values, unit, minimum=0.0), strict=True)
    ]


def per_joint(
    joints: Sequence[str], name: str, values: PerJoint, unit: str, minimum: float | None = None
) -> tuple[float, ...]:
    """Return one value for each joint.

    Raises:
        InputError: the number of values is wrong, or a value isn't finite or is below ``minimum``.
    """
    # one number for all joints, or one for each
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be a number [{unit}] or one for each joint, got {values!r}") from None
    if array.shape not in ((), (len(joints),)):
        raise InputError(
            f"{name} must be one number or {len(joints)} (one for each of {', '.join(joints)}), got shape {array.shape}"
        )
    result = tuple(float(value) for value in np.broadcast_to(array, (len(joints),)))
    # check each value
    suffix = "" if unit == "1" else f" {unit}"
    for joint, value in zip(joints, result, strict=True):
        if not isfinite(value):
            raise InputError(f"{name} of {joint} must be finite, got {value}{suffix}")
        if minimum is not None and value < minimum:
            raise InputError(f"{name} of {joint} must be at least {minimum}{suffix}, got {value}")
    return result


@dataclass(frozen=True)
class Limits:
    """Smallest and largest torque [N.m]: one number for all joints, or one for each."""

    lower: PerJoint
    upper: PerJoint

    def parameters(self, joints: Sequence[str]) -> list[Variable]:
        """Return the tunable parameters ``joint1.torque.minimum``, ..., ``joint1.torque.maximum``, ...

        Raises:
            InputError: a limit isn't finite, or the lower one isn't below the upper one.
        """
        # lower limit below upper limit for every joint
        lower = per_joint(joints, "the lower torque limit", self.lower, "N.m")
        upper = per_joint(joints, "the upper torque limit", self.upper, "N.m")
        for joint, low, high in zip(joints, lower, upper, strict=True):
            if not low < high:
                raise InputError(f"{joint}: the lower torque limit {low} N.m must be below the upper one, {high} N.m")
        # all minima, then all maxima: the order in which equations split them
        return [
            Variable(f"{joint}.torque.{end}", "N.m", f"The {end} torque of {joint}", "parameter", value, tunable=True)
            for end, values in (("minimum", lower), ("maximum", upper))
            for joint, value in zip(joints, values, strict=True)
        ]


def symmetric(limit: PerJoint) -> Limits:
    """Return the limits ±limit [N.m]."""
    lower = -limit if isinstance(limit, (int, float)) else tuple(-value for value in limit)
    return Limits(lower, limit)


def torque_limits(limit: PerJoint | None) -> Limits | None:
    """Return the limits ±limit [N.m] of a section of the scene file; None for none."""
    return None if limit is None else symmetric(limit)


def saturate(value: Vector, lower: Vector, upper: Vector) -> Vector:
    """Return the value within its limits. NaN stays NaN; minimum and maximum would turn it into a limit."""
    return casadi.if_else(value > upper, upper, casadi.if_else(value < lower, lower, value))


Law = Callable[[Vector, list[Vector], list[Vector]], tuple[Vector, Vector]]
"""(states, signals, gains) → (torques before feedforward and limits, next states); every signal and every gain is a
vector with one element for each joint."""


def torque_equations(law: Law, joints: Sequence[str], limits: Limits | None) -> Equations:
    """Return the equations of torque = sat(law + feedforward).

    The block's inputs must end with `feedforwards`, its parameters with those of the limits.

    Args:
        law: the control law.
        joints: names of the joints.
        limits: torque limits; None for none.
    """
    n = len(joints)

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # signals, gains and limits, each with one element for each joint
        *signals, feedforward = split(u, n)
        gains = split(p, n)
        lower, upper = (gains.pop(-2), gains.pop()) if limits else (None, None)
        # the law, the feedforward, then the limits
        torque, following = law(x, signals, gains)
        torque = torque + feedforward
        return saturate(torque, lower, upper) if limits else torque, following

    return equations
