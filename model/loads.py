"""Payload and gravity."""

from __future__ import annotations

import casadi

from flexfmu.model.effects import Effect
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import Robot
from flexfmu.model.symbolic import Variable


class PointPayload(Effect):
    """Point mass at the end effector."""

    def __init__(self, registry: ParameterRegistry, mass: float) -> None:
        self._mass = registry.derived(
            "payload_mass",
            registry.parameter(
                Variable(
                    "payload.mass",
                    "kg",
                    "Point mass at the end effector",
                    "parameter",
                    start=mass,
                    minimum=0.0,
                    maximum=1e6,
                )
            ),
        )

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        return 0.5 * self._mass * casadi.dot(robot.velocity, robot.velocity)

    def first_moment(self, robot: Robot) -> casadi.SX:
        return self._mass * robot.position


class Gravity(Effect):
    """Uniform gravity of any direction in the plane, eq. (14)."""

    def __init__(self, registry: ParameterRegistry, gravity: tuple[float, float]) -> None:
        self._gravity = casadi.vertcat(
            *(
                registry.derived(
                    f"gravity_{axis}",
                    registry.parameter(
                        Variable(
                            f"gravity.{axis}",
                            "m/s2",
                            f"Gravity along {axis}",
                            "parameter",
                            start=g,
                            minimum=-1e4,
                            maximum=1e4,
                        )
                    ),
                )
                for axis, g in zip("xy", gravity, strict=True)
            )
        )

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        return -casadi.dot(self._gravity, first_moment)
