"""Loads and drives of the robot: payload, gravity, structural damping, motor inertia, joint friction and elastic transmissions."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from functools import partial

import casadi
import numpy as np

from flexfmu.model.effects import Effect, EffectContext, Stiction, derived_matrix, dot, form
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import Family, Robot
from flexfmu.model.scene import effects as keys
from flexfmu.model.symbolic import EffectNote, Variable


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
            yield cls(context, inertia)

    def __init__(self, context: EffectContext, inertia: float) -> None:
        """`inertia` in kg m²."""
        text = "Rotary inertia of the payload about the end effector, turning with link 12"
        self._inertia = context.registry.quantity("payload.inertia", "kg.m2", text, inertia, maximum=1e6)
        self._length, self._exact = context.links["distal"].length, context.scene.effects.foreshortening == "exact"

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        link = robot.links["link12"]
        rate, bending = link.turning_rate, link.family("bending")
        if bending is not None:
            turning = casadi.SX([float(shape.rotation(np.ones(1))[0]) for shape in bending.family.shapes])
            bent = dot(turning, bending.v) / self._length
            # with exact bending this is the rate of the angle's sine
            rate += bent / casadi.sqrt(1.0 - (dot(turning, bending.q) / self._length) ** 2) if self._exact else bent
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


class StructuralDamping(Effect):
    """Damping of every elastic family; a subclass gives the law."""

    def dissipation(self, robot: Robot) -> casadi.SX:
        return sum((self._power(part.family, part.v) for _, part in robot.elastic), casadi.SX(0))

    @abstractmethod
    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        """Rayleigh's dissipation function [W] of one family on one link, for modal rates v (K, 1)."""


class ModalDamping(StructuralDamping):
    """Modal damping C_ii = 2 ratio sqrt(K_ii M_ii) of every mode of every link."""

    note = EffectNote(
        "modal damping",
        "Modal damping C_ii = 2 ratio sqrt(K_ii M_ii) of every mode of every link.",
        "R = ½ ∑ 2ζ √(K_kk M_kk) q̇_k²",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        damping = context.scene.effects.damping
        if isinstance(damping, keys.ModalDampingSection) and damping.ratio:
            yield cls(context.registry, damping.ratio)

    def __init__(self, registry: ParameterRegistry, ratio: float) -> None:
        self._registry = registry
        text = "Modal damping ratio of the link modes"
        self._ratio = registry.parameter(_factor("damping.ratio", "1", text, ratio, 1e3))

    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        total = casadi.SX(0)
        for k in range(v.numel()):
            c = 2 * self._ratio * casadi.sqrt(family.stiffness[k, k] * family.mass[k, k])
            total += 0.5 * self._registry.derived(f"{family.group}_{family.direction}_c_{k}", c) * v[k] ** 2
        return total


class ProportionalDamping(StructuralDamping):
    """Damping C = rate * M + time * K on the elastic coordinates, with the links' own modal masses (Rayleigh)."""

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        damping = context.scene.effects.damping
        rate = damping.rate if isinstance(damping, keys.MassDampingSection | keys.RayleighDampingSection) else 0.0
        if rate or context.damping_time() is not None:
            yield cls(context, rate)

    def __init__(self, context: EffectContext, rate: float) -> None:
        """A `rate` [1/s] of zero removes its term, and so does the scene's time of zero."""
        # parameters of the terms that the scene has
        self._registry, self._has_rate = context.registry, bool(rate)
        if rate:
            text = "Mass-proportional damping rate"
            self._rate = self._registry.parameter(_factor("damping.rate", "1/s", text, rate, 1e6))
        self._time = context.damping_time()
        # the note names these terms
        present = (("mass", "αM", self._has_rate), ("stiffness", "βK", self._time is not None))
        terms = [(kind, symbol) for kind, symbol, there in present if there]
        self.note = EffectNote(
            " and ".join(kind for kind, _ in terms) + " proportional damping",
            "Damping C = rate * M + time * K on the elastic coordinates, with the links' own modal masses (Rayleigh).",
            f"R = ½ q̇ᵀ ({' + '.join(symbol for _, symbol in terms)}) q̇",
        )

    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        damping = casadi.SX(*family.stiffness.shape)
        if self._has_rate:
            damping += self._rate * family.mass
        if self._time is not None:
            damping += self._time * family.stiffness
        derived = derived_matrix(self._registry, f"{family.group}_{family.direction}_c", damping)
        return 0.5 * form(derived, v, v)


def _factor(name: str, unit: str, text: str, start: float, maximum: float) -> Variable:
    return Variable(name, unit, text, "parameter", start=start, minimum=0.0, maximum=maximum)


class MotorInertia(Effect):
    """Inertia of each motor, referred to its joint."""

    note = EffectNote("motor inertia", "Inertia of each motor, referred to its joint.", "T = ½ J (q̇₁² + q̇₂²)")

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        if inertia := context.scene.effects.motor_inertia:
            yield cls(context.registry, inertia)

    def __init__(self, registry: ParameterRegistry, inertia: float) -> None:
        self._inertia = registry.quantity(
            "motor_inertia", "kg.m2", "Inertia of each motor, referred to its joint", inertia
        )

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        return 0.5 * self._inertia * sum(rate**2 for rate in robot.motor_rates)


class ViscousFriction(Effect):
    """Viscous friction torque at each motor."""

    note = EffectNote("viscous friction", "Viscous friction torque at each motor.", "R = ½ d (q̇₁² + q̇₂²)")

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        if coefficient := context.scene.effects.joint_friction.viscous:
            yield cls(context.registry, coefficient)

    def __init__(self, registry: ParameterRegistry, coefficient: float) -> None:
        self._coefficient = registry.quantity(
            "joint_friction.viscous", "N.m.s/rad", "Viscous friction of each motor", coefficient
        )

    def dissipation(self, robot: Robot) -> casadi.SX:
        return 0.5 * self._coefficient * sum(rate**2 for rate in robot.motor_rates)


class CoulombFriction(Effect):
    """Dry friction at each motor, smoothed to the torque coulomb * w / sqrt(w² + velocity²).

    w is the motor rate. The dissipation function coulomb * sqrt(w² + velocity²) is analytic and never overflows.
    """

    note = EffectNote(
        "coulomb friction",
        "Dry friction at each motor, smoothed to the torque coulomb * w / sqrt(w² + velocity²).",
        "R = c ∑ √(w² + q̇_i²)",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        friction = context.scene.effects.joint_friction
        if isinstance(friction, keys.SmoothFrictionSection) and friction.coulomb:
            yield cls(context.registry, friction.coulomb, friction.velocity)

    def __init__(self, registry: ParameterRegistry, torque: float, velocity: float) -> None:
        self._torque = registry.quantity("joint_friction.coulomb", "N.m", "Coulomb friction of each motor", torque)
        self._velocity = registry.quantity(
            "joint_friction.velocity", "rad/s", "Motor rate that smooths the Coulomb friction", velocity, 1e-9
        )

    def dissipation(self, robot: Robot) -> casadi.SX:
        return self._torque * sum(casadi.sqrt(rate**2 + self._velocity**2) for rate in robot.motor_rates)


class StickingFriction(Effect):
    """Dry friction: a motor sticks up to the breakaway torque; while it slips, friction falls with its rate.

    The friction torque at the rate v is coulomb + (breakaway - coulomb) exp(-(v / stribeck_velocity)²) (Stribeck's
    curve; Armstrong- Hélouvry, Dupont and Canudas de Wit, Automatica 30 (1994), eq. (5)), or coulomb without a Stribeck
    velocity. A breakaway torque below the Coulomb friction counts as equal to it.
    """

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        friction = context.scene.effects.joint_friction
        if isinstance(friction, keys.StictionSection) and friction.holding:
            yield cls(context.registry, friction.coulomb, friction.holding, friction.stribeck_velocity)

    def __init__(
        self, registry: ParameterRegistry, coulomb: float, breakaway: float, stribeck_velocity: float | None
    ) -> None:
        # sliding friction and breakaway torque, which is never below it
        self._coulomb = registry.quantity(
            "joint_friction.coulomb", "N.m", "Coulomb friction of each motor that turns", coulomb
        )
        largest = registry.quantity(
            "joint_friction.breakaway", "N.m", "Largest torque that holds a motor at rest", breakaway
        )
        self._breakaway = registry.derived("joint_friction_holding", casadi.fmax(largest, self._coulomb))
        # rate over which friction falls from the one to the other
        self._velocity = stribeck_velocity and registry.quantity(
            "joint_friction.stribeck_velocity",
            "rad/s",
            "Motor rate at which friction has fallen from breakaway by 63 %",
            stribeck_velocity,
            1e-9,
        )
        # slip directions, which events switch
        self._directions = [registry.switch(f"joint{leg}_slip_direction") for leg in (1, 2)]
        falling = "" if self._velocity is None else " + (b - c) ∫ exp(-(v/w)²) dv"
        self.note = EffectNote(
            "sticking friction",
            "Dry friction that holds each motor up to its breakaway torque, and opposes its slip with less at higher rates.",
            f"R = ∑ c |q̇_i|{falling}; q̈_i = 0 up to |τ_i| = b",
        )

    def _torque(self, direction: casadi.SX, rate: casadi.SX) -> casadi.SX:
        excess = self._breakaway - self._coulomb
        falling = 0.0 if self._velocity is None else excess * casadi.exp(-((rate / self._velocity) ** 2))
        return _slip(direction, rate) * (self._coulomb + falling)

    def dissipation(self, robot: Robot) -> casadi.SX:
        total = casadi.SX(0)
        for direction, rate in zip(self._directions, robot.motor_rates, strict=True):
            potential = self._coulomb * rate
            if self._velocity is not None:
                reach = 0.5 * math.sqrt(math.pi) * (self._breakaway - self._coulomb) * self._velocity
                potential += reach * casadi.erf(rate / self._velocity)
            total += _slip(direction, rate) * potential
        return total

    def stiction(self) -> Sequence[Stiction]:
        return [
            Stiction(partial(self._torque, direction), self._breakaway, direction) for direction in self._directions
        ]


def _slip(direction: casadi.SX, rate: casadi.SX) -> casadi.SX:
    """The direction of slip: the value of the switch, or the sign of the rate where the switch is 0."""
    return direction + (direction == 0.0) * casadi.sign(rate)


class ElasticTransmission(Effect):
    """Spring and damper between each motor and its proximal link."""

    note = EffectNote(
        "elastic transmission",
        "Spring and damper between each motor and its proximal link.",
        "V = ½ k ∑ ϑ_i², R = ½ d ∑ ϑ̇_i², where ϑ is link angle minus motor angle",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        if (transmission := context.scene.effects.transmission) is not None:
            yield cls(context.registry, transmission.stiffness, transmission.damping)

    def __init__(self, registry: ParameterRegistry, stiffness: float, damping: float) -> None:
        self._stiffness = registry.quantity(
            "transmission.stiffness", "N.m/rad", "Stiffness of each transmission", stiffness, 1e-9
        )
        self._damping = (
            registry.quantity("transmission.damping", "N.m.s/rad", "Damping of each transmission", damping)
            if damping
            else casadi.SX(0)
        )

    def joint_stiffness(self) -> casadi.SX:
        return self._stiffness

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        return 0.5 * self._stiffness * casadi.dot(robot.twist, robot.twist)

    def dissipation(self, robot: Robot) -> casadi.SX:
        return 0.5 * self._damping * casadi.dot(robot.twist_rate, robot.twist_rate)
