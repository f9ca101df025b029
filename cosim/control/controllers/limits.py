"""Limits of a controller's outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi

from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.controllers.joints import PerJoint, per_joint
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.symbolic import Variable


@dataclass(frozen=True)
class Limits:
    """Smallest and largest torque [N.m], for all joints or one for each."""

    lower: PerJoint
    upper: PerJoint

    def parameters(self, joints: Sequence[str]) -> list[Variable]:
        """Tunable parameters ``joint1.torque.minimum``, ..., ``joint1.torque.maximum``, ...

        Raises:
            InputError: a limit isn't finite, or the lower one isn't below the upper one.
        """
        lower = per_joint(joints, "the lower torque limit", self.lower, "N.m")
        upper = per_joint(joints, "the upper torque limit", self.upper, "N.m")
        for joint, low, high in zip(joints, lower, upper, strict=True):
            if not low < high:
                raise InputError(f"{joint}: the lower torque limit {low} N.m must be below the upper one, {high} N.m")
        return [
            Variable(f"{joint}.torque.{end}", "N.m", f"The {end} torque of {joint}", "parameter", value, tunable=True)
            for end, values in (("minimum", lower), ("maximum", upper))
            for joint, value in zip(joints, values, strict=True)
        ]


def symmetric(limit: PerJoint) -> Limits:
    """Limits ±limit [N.m]."""
    lower = -limit if isinstance(limit, (int, float)) else tuple(-value for value in limit)
    return Limits(lower, limit)


def torque_limits(limit: PerJoint | None) -> Limits | None:
    """Limits ±limit [N.m] of a section of the scene file; None for none."""
    return None if limit is None else symmetric(limit)


def saturate(value: Vector, lower: Vector, upper: Vector) -> Vector:
    """The value within its limits. NaN stays NaN, whereas minimum and maximum would turn it into a limit."""
    return casadi.if_else(value > upper, upper, casadi.if_else(value < lower, lower, value))
