"""Functions of a scene's model with numeric parameter values: flexible robot and rigid inverse dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi
import numpy as np

from flexfmu.model.beams import FAMILIES
from flexfmu.model.five_bar import assemble
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
    """

    n: int
    names: tuple[str, ...]
    elastic_forces: casadi.Function
    static_stiffness: casadi.Function
    mass_matrix: casadi.Function
    motion: casadi.Function
    energy: casadi.Function


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
