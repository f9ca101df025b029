"""Payload and gravity."""

from __future__ import annotations

from collections.abc import Iterator

import casadi
import numpy as np

from flexfmu.model.effects import Effect, EffectContext, dot
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import Robot
from flexfmu.model.symbolic import EffectNote


class PointPayload(Effect):
    """Point mass at the end effector."""

    note = EffectNote("point payload", "Point mass at the end effector.", "T = ½ m |Ẋ|²")

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        if mass := context.scene.payload.mass:
            yield cls(context.registry, mass)

    def __init__(self, registry: ParameterRegistry, mass: float) -> None:
        self._mass = registry.quantity("payload.mass", "kg", "Point mass at the end effector", mass, maximum=1e6)

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        return 0.5 * self._mass * casadi.dot(robot.velocity, robot.velocity)

    def first_moment(self, robot: Robot) -> casadi.SX:
        return self._mass * robot.position

    def end_effector_mass(self) -> casadi.SX:
        return self._mass


class PayloadInertia(Effect):
    """Rotary inertia of the payload, which turns with the last cross section of link 12.

    The payload, a gripper for example, is mounted on the distal link of leg 1. A payload of constant orientation,
    guided by a parallelogram for example, has no such effect.
    """

    note = EffectNote(
        "payload inertia",
        "Rotary inertia of the payload, which turns with the last cross section of link 12.",
        "T = ½ J ω², where ω is the rate of the section",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        if inertia := context.scene.payload.inertia:
            yield cls(context.registry, inertia, context.links["distal"].length)

    def __init__(self, registry: ParameterRegistry, inertia: float, length: casadi.SX) -> None:
        """`inertia` in kg m²; `length` is that of the distal links [m]."""
        text = "Rotary inertia of the payload about the end effector, turning with link 12"
        self._inertia = registry.quantity("payload.inertia", "kg.m2", text, inertia, maximum=1e6)
        self._length = length

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        link = robot.links["link12"]
        rate, bending = link.turning_rate, link.family("bending")
        if bending is not None:
            turning = [float(shape.rotation(np.ones(1))[0]) for shape in bending.family.shapes]
            rate += dot(casadi.SX(turning), bending.v) / self._length
        return 0.5 * self._inertia * rate**2


class Gravity(Effect):
    """Uniform gravity of any direction in the plane, eq. (14) of Barnard, Briot and Caro (2012)."""

    note = EffectNote(
        "gravity",
        "Uniform gravity of any direction in the plane, eq. (14) of Barnard, Briot and Caro (2012).",
        "V = −g · ∑ ∫ X dm",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        gravity = context.scene.effects.gravity
        if any(gravity):
            yield cls(context.registry, gravity)

    def __init__(self, registry: ParameterRegistry, gravity: tuple[float, float]) -> None:
        self._gravity = casadi.vertcat(
            *(
                registry.quantity(f"gravity.{axis}", "m/s2", f"Gravity along {axis}", g, -1e4, 1e4)
                for axis, g in zip("xy", gravity, strict=True)
            )
        )

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        return -casadi.dot(self._gravity, first_moment)
