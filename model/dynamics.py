"""Equations of motion in redundant coordinates from the energies: Lagrange's equations, eq. (17) without multipliers.

The redundant coordinates are the link angles, the base points of the distal links, the end-effector position and the
elastic coordinates. Their constraints enter in `flexfmu.model.closure` (index reduction) or as multipliers
(`flexfmu.model.multipliers`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi

from flexfmu.model.effects import Effect
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import LINK_ORDER, Robot

ANGLE_ORDER = ("link11", "link21", "link12", "link22")
"""Links in the order of their angular rates: actuated links first."""


@dataclass(frozen=True)
class RedundantState:
    """A motion in redundant coordinates, as symbols or expressions.

    Attributes:
        directions: unit vectors e of link 11, 21, 12, 22, each (2, 1).
        points: base points P1, P2 of the distal links [m], each (2, 1).
        position: end effector X [m], (2, 1).
        elastic: elastic coordinates q_e (n, 1).
        rates, accelerations: [w11, w21, w12, w22, P1', P2', X', q_e'] and their time derivatives, (10 + n, 1).
    """

    directions: tuple[casadi.SX, ...]
    points: tuple[casadi.SX, casadi.SX]
    position: casadi.SX
    elastic: casadi.SX
    rates: casadi.SX
    accelerations: casadi.SX

    def arguments(self) -> tuple[casadi.SX, ...]:
        """Arguments (x, rates, accelerations) of `RedundantDynamics.force`; the derived values d are missing."""
        configuration = casadi.vertcat(*self.directions, *self.points, self.position, self.elastic)
        return configuration, self.rates, self.accelerations


@dataclass(frozen=True)
class RedundantDynamics:
    """Functions of the redundant configuration x = [e11, e21, e12, e22, P1, P2, X, q_e] (14 + n, 1).

    Attributes:
        force: (x, rates, accelerations, d) → generalised forces that the motion needs (10 + n, 1): inertial, elastic,
            gravitational and dissipative forces.
        energy: (x, rates, d) → [kinetic, potential] energy [J].
        is_damped: whether the elastic rates dissipate energy.
    """

    force: casadi.Function
    energy: casadi.Function
    is_damped: bool


def derive_dynamics(robot: Robot, effects: Sequence[Effect], registry: ParameterRegistry) -> RedundantDynamics:
    """Lagrange's equations for the sum of all effects, which register their derived values."""
    # configuration, rates and accelerations in the order of `RedundantState`
    links = [robot.links[name] for name in ANGLE_ORDER]
    points = [robot.links[name].base for name, group, _ in LINK_ORDER if group == "distal"]
    point_rates = [robot.links[name].base_velocity for name, group, _ in LINK_ORDER if group == "distal"]
    x = casadi.vertcat(*(link.direction for link in links), *points, robot.position, robot.q_e)
    v = casadi.vertcat(*(link.turning_rate for link in links), *point_rates, robot.velocity, robot.v_e)
    a = casadi.SX.sym("a", v.numel())

    # sums over all effects; gravity acts on the first moment of all masses
    kinetic = sum((effect.kinetic_energy(robot) for effect in effects), casadi.SX(0))
    moment = sum((effect.first_moment(robot) for effect in effects), casadi.SX(2, 1))
    potential = sum((effect.potential_energy(robot, moment) for effect in effects), casadi.SX(0))
    dissipation = sum((effect.dissipation(robot) for effect in effects), casadi.SX(0))

    # x' for rates v: the unit vectors rotate, the rate of all else is part of v
    turning = [casadi.vertcat(-x[2 * i + 1] * v[i], x[2 * i] * v[i]) for i in range(4)]
    tangent = casadi.vertcat(*turning, v[4:])

    # derivative of T - V with respect to the coordinates; for an angle, along the rotation of its unit vector
    gradient = casadi.gradient(kinetic - potential, x)
    angles = [x[2 * i] * gradient[2 * i + 1] - x[2 * i + 1] * gradient[2 * i] for i in range(4)]
    by_coordinates = casadi.vertcat(*angles, gradient[8:])

    # Lagrange: d/dt dT/dv - d(T - V)/dq + dR/dv
    momentum = casadi.gradient(kinetic, v)
    inertia = casadi.jtimes(momentum, casadi.vertcat(x, v), casadi.vertcat(tangent, a))
    force = inertia - by_coordinates + casadi.gradient(dissipation, v)
    return RedundantDynamics(
        force=casadi.Function("force", [x, v, a, registry.d], [casadi.densify(casadi.cse(force))]),
        energy=casadi.Function("energy", [x, v, registry.d], [casadi.densify(casadi.vertcat(kinetic, potential))]),
        is_damped=casadi.depends_on(dissipation, robot.v_e),
    )
