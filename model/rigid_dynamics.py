"""Inverse dynamics of the rigid robot, for controllers that compute torques from a model."""

from __future__ import annotations

import casadi

from flexfmu.model.chosen_effects import FAMILIES
from flexfmu.model.five_bar import assemble
from flexfmu.model.scene import Scene


def rigid_scene(scene: Scene) -> Scene:
    """The scene with rigid links and rigid transmissions."""
    stiff = {f"effects.{group}_{direction}": 0 for group, direction in FAMILIES}
    return scene.replace(stiff | {"effects.transmission": None, "effects.quasi_static": []})


def inverse_dynamics(scene: Scene) -> casadi.Function:
    """Motor torques of the rigid robot: (q_a, v_a, a_a), each (2, 1) [rad, rad/s, rad/s²] → torque (2, 1) [N m].

    Inertia of links, motors and payload, gravity and friction of the scene are in it, with the scene's numbers.
    """
    five_bar = assemble(rigid_scene(scene))
    registry, motion = five_bar.registry, five_bar.motion
    derive = casadi.Function("derive", [registry.p], [registry.resolved()])
    values = derive([registry.starts[variable.name] for variable in registry.variables])
    torque = casadi.substitute(five_bar.forces.motors, registry.d, values)
    return casadi.Function(
        "inverse_dynamics", [motion.q_a, motion.v_a, motion.a_a], [casadi.densify(casadi.cse(torque))]
    )
