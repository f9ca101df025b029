"""Variables of joint controllers: names, units, and gains for one joint or all."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Literal

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.symbolic import Variable

JOINTS = ("joint1", "joint2")
"""Actuated joints of the five-bar."""

Kind = Literal["position", "velocity", "acceleration"]
UNITS: dict[Kind, str] = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s2"}

PerJoint = float | Sequence[float]
"""One number for all joints, or one for each."""


def references(joints: Sequence[str], kind: Kind) -> list[Variable]:
    """Inputs ``joint1.reference.position`` and so on."""
    return [
        Variable(f"{joint}.reference.{kind}", UNITS[kind], f"Reference {kind} of {joint}", "input", 0.0)
        for joint in joints
    ]


def measurements(joints: Sequence[str], kind: Kind) -> list[Variable]:
    """Inputs ``joint1.position`` and so on."""
    return [Variable(f"{joint}.{kind}", UNITS[kind], f"Measured {kind} of {joint}", "input", 0.0) for joint in joints]


def feedforwards(joints: Sequence[str]) -> list[Variable]:
    """Inputs ``joint1.feedforward``: torques that are added before the limits."""
    return [
        Variable(f"{joint}.feedforward", "N.m", f"Torque added to that of the controller of {joint}", "input", 0.0)
        for joint in joints
    ]


def feedforward_outputs(joints: Sequence[str], what: str) -> list[Variable]:
    """Outputs ``joint1.feedforward`` of a slave that makes such torques."""
    return [Variable(f"{joint}.feedforward", "N.m", f"{what} of {joint}", "output") for joint in joints]


def torques(joints: Sequence[str]) -> list[Variable]:
    """Outputs ``joint1.torque``."""
    return [Variable(f"{joint}.torque", "N.m", f"Torque of {joint}, counter-clockwise", "output") for joint in joints]


def gains(joints: Sequence[str], name: str, values: PerJoint, unit: str, what: str) -> list[Variable]:
    """Tunable parameters ``joint1.<name>``, zero or positive.

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
    """One value for each joint.

    Raises:
        InputError: the number of values is wrong, or a value isn't finite or is too small.
    """
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be a number [{unit}] or one for each joint, got {values!r}") from None
    if array.shape not in ((), (len(joints),)):
        raise InputError(
            f"{name} must be one number or {len(joints)} (one for each of {', '.join(joints)}), got shape {array.shape}"
        )
    result = tuple(float(value) for value in np.broadcast_to(array, (len(joints),)))
    for joint, value in zip(joints, result, strict=True):
        if not isfinite(value):
            raise InputError(f"{name} of {joint} must be finite, got {value} {unit}")
        if minimum is not None and value < minimum:
            raise InputError(f"{name} of {joint} must be at least {minimum} {unit}, got {value}")
    return result
