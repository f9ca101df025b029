"""Functions of a scene's model with numeric parameter values: flexible robot and rigid inverse dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi
import numpy as np

from flexfmu.model.beams import FAMILIES
from flexfmu.model.five_bar import assemble
from flexfmu.model.robot import Robot
from flexfmu.model.scene.mechanism import LinkSection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray


@dataclass(frozen=True)
class NumericModel:
    """Functions of a scene's five-bar with numeric parameter values.

    Attributes:
        n: number of elastic coordinates that are states.
        names: names of these coordinates, like ``link11.bending[1]``.
        elastic_forces: (q_e, v_e, a_e, u) → forces on q_e (n, 1) [N]; u = [q_a, v_a, a_a] (6, 1).
        static_stiffness: (q_e, u) → Jacobian of the static elastic forces by q_e (n, n) [N/m].
        mass_matrix: (q_e, u) → (n, n) [kg].
        motion: (q_e, v_e, a_e, u) → position, velocity, acceleration of the end effector and torques, each (2, 1).
        energy: (q_e, v_e, u) → [kinetic, potential] [J].
        hardening: q_e → elastic forces (n, 1) [N] of the next order, which the model neglects, see `bending_beyond`.
    """

    n: int
    names: tuple[str, ...]
    elastic_forces: casadi.Function
    static_stiffness: casadi.Function
    mass_matrix: casadi.Function
    motion: casadi.Function
    energy: casadi.Function
    hardening: casadi.Function


@lru_cache(maxsize=32)
def numeric_model(scene: Scene) -> NumericModel:
    """The numeric model of a scene, cached."""
    # the five-bar in symbols, and numbers for its derived values
    five_bar = assemble(scene)
    m, closure = five_bar.motion, five_bar.closure
    u = casadi.vertcat(m.q_a, m.v_a, m.a_a)
    values = five_bar.registry.derived_at_start()

    def function(name: str, arguments: list[casadi.SX], results: list[casadi.SX]) -> casadi.Function:
        filled = [casadi.densify(casadi.cse(casadi.substitute(r, five_bar.registry.d, values))) for r in results]
        return casadi.Function(name, arguments, filled)

    # forces in motion and at rest, energies
    force, zeros = five_bar.forces.elastic, casadi.SX.zeros(m.q_e.numel())
    at_rest = casadi.substitute(force, casadi.vertcat(m.v_e, m.a_e), casadi.vertcat(zeros, zeros))
    state = closure.redundant()
    energy = five_bar.dynamics.energy(state.arguments()[0], state.rates, five_bar.registry.d)
    return NumericModel(
        n=m.q_e.numel(),
        names=tuple(five_bar.robot.elastic_names[i] for i in five_bar.partition.states),
        elastic_forces=function("elastic_forces", [m.q_e, m.v_e, m.a_e, u], [force]),
        static_stiffness=function("static_stiffness", [m.q_e, u], [casadi.jacobian(at_rest, m.q_e)]),
        mass_matrix=function("mass_matrix", [m.q_e, u], [casadi.jacobian(force, m.a_e)]),
        motion=function(
            "motion",
            [m.q_e, m.v_e, m.a_e, u],
            [five_bar.position, closure.velocity, closure.acceleration, five_bar.forces.motors],
        ),
        energy=function("energy", [m.q_e, m.v_e, u], [energy]),
        hardening=function("hardening", [m.q_e], [casadi.gradient(bending_beyond(five_bar.robot, scene), m.q_e)]),
    )


def standstill(joints: tuple[float, float] | RealArray) -> RealArray:
    """u = [q_a, 0, 0], shape (6,), for locked motors at the angles [rad]."""
    return np.concatenate([np.asarray(joints, dtype=float), np.zeros(4)])


def inverse_dynamics(scene: Scene) -> casadi.Function:
    """Motor torques of the rigid robot: (q_a, v_a, a_a), each (2, 1) [rad, rad/s, rad/s²] → torque (2, 1) [N m].

    It contains inertia of links, motors and payload, gravity and friction, with the values of the scene.
    """
    # the scene with rigid links and rigid transmissions
    stiff = {f"effects.{group}_{direction}": 0 for group, direction in FAMILIES}
    five_bar = assemble(scene.replace(stiff | {"effects.transmission": None, "effects.quasi_static": []}))
    # its motor torques, with numbers for the parameters
    registry, motion = five_bar.registry, five_bar.motion
    torque = casadi.substitute(five_bar.forces.motors, registry.d, registry.derived_at_start())
    return casadi.Function(
        "inverse_dynamics", [motion.q_a, motion.v_a, motion.a_a], [casadi.densify(casadi.cse(torque))]
    )


def bending_beyond(robot: Robot, scene: Scene) -> casadi.SX:
    """Bending energy of fourth order, which the model neglects: 1/2 ∫ EI w''² w'² dx [J].

    The curvature of an inextensible line is w'' / sqrt(1 - w'²). The other terms of this order (inertia of the
    shortening, w'⁴ / 8) are far smaller, see ``tests/cosim/metrics/test_large_deflections.py``.

    Source: Crespo da Silva and Glynn, Nonlinear flexural-flexural-torsional dynamics of inextensional beams, J. Struct.
    Mech. 6 (1978), eq. (14) in the plane.
    """
    # slopes and strains at the quadrature nodes, as functions of the elastic coordinates
    xi, weights = np.polynomial.legendre.leggauss(40)
    energy = casadi.SX(0)
    for link, part in robot.elastic:
        if part.family.direction != "bending":
            continue
        geometry: LinkSection = getattr(scene.mechanism, link.group)
        second = np.pi / 64.0 * (geometry.diameter**4 - geometry.inner_diameter**4)
        slopes, strains = (
            casadi.DM(np.stack([field(0.5 * (xi + 1.0)) for field in fields], axis=1)) @ part.q
            for fields in zip(*((shape.slope, shape.strain) for shape in part.family.shapes), strict=True)
        )
        rigidity = scene.mechanism.material.youngs_modulus * second / geometry.length**5
        energy += 0.5 * rigidity * casadi.dot(casadi.DM(0.5 * weights), (slopes * strains) ** 2)
    return energy
