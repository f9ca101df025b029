"""Effects of the drives: motor inertia, joint friction and elastic transmissions."""

from __future__ import annotations

import casadi

from flexfmu.model.effects import Effect
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import Robot
from flexfmu.model.symbolic import Variable

LARGEST = 1e9
"""Upper limit of a drive parameter in its SI unit."""


def _parameter(
    registry: ParameterRegistry, name: str, unit: str, text: str, start: float, minimum: float = 0.0
) -> casadi.SX:
    variable = Variable(name, unit, text, "parameter", start=start, minimum=minimum, maximum=LARGEST)
    return registry.derived(name.replace(".", "_"), registry.parameter(variable))


class MotorInertia(Effect):
    """Inertia of each motor, referred to its joint."""

    def __init__(self, registry: ParameterRegistry, inertia: float) -> None:
        self._inertia = _parameter(
            registry, "motor_inertia", "kg.m2", "Inertia of each motor, referred to its joint", inertia
        )

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        return 0.5 * self._inertia * sum(rate**2 for rate in robot.motor_rates)

    def formula(self) -> str:
        return "T = ½ J (q̇₁² + q̇₂²)"


class ViscousFriction(Effect):
    """Viscous friction torque at each motor."""

    def __init__(self, registry: ParameterRegistry, coefficient: float) -> None:
        self._coefficient = _parameter(
            registry, "joint_friction.viscous", "N.m.s/rad", "Viscous friction of each motor", coefficient
        )

    def dissipation(self, robot: Robot) -> casadi.SX:
        return 0.5 * self._coefficient * sum(rate**2 for rate in robot.motor_rates)

    def formula(self) -> str:
        return "R = ½ d (q̇₁² + q̇₂²)"


class CoulombFriction(Effect):
    """Dry friction at each motor, smoothed to the torque coulomb * w / sqrt(w² + velocity²).

    Its dissipation function is coulomb * sqrt(w² + velocity²), which is analytic and never overflows.
    """

    def __init__(self, registry: ParameterRegistry, torque: float, velocity: float) -> None:
        self._torque = _parameter(registry, "joint_friction.coulomb", "N.m", "Coulomb friction of each motor", torque)
        self._velocity = _parameter(
            registry, "joint_friction.velocity", "rad/s", "Motor rate that smooths the Coulomb friction", velocity, 1e-9
        )

    def dissipation(self, robot: Robot) -> casadi.SX:
        return self._torque * sum(casadi.sqrt(rate**2 + self._velocity**2) for rate in robot.motor_rates)

    def formula(self) -> str:
        return "R = c ∑ √(w² + q̇_i²)"


class ElasticTransmission(Effect):
    """Spring and damper between each motor and its proximal link."""

    def __init__(self, registry: ParameterRegistry, stiffness: float, damping: float) -> None:
        self._stiffness = _parameter(
            registry, "transmission.stiffness", "N.m/rad", "Stiffness of each transmission", stiffness, 1e-9
        )
        self._damping = (
            _parameter(registry, "transmission.damping", "N.m.s/rad", "Damping of each transmission", damping)
            if damping
            else casadi.SX(0)
        )

    def twists_joints(self) -> bool:
        return True

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        return 0.5 * self._stiffness * casadi.dot(robot.twist, robot.twist)

    def dissipation(self, robot: Robot) -> casadi.SX:
        return 0.5 * self._damping * casadi.dot(robot.twist_rate, robot.twist_rate)

    def formula(self) -> str:
        return "V = ½ k ∑ ϑ_i², R = ½ d ∑ ϑ̇_i², where ϑ is link angle minus motor angle"
