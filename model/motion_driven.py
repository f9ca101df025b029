"""The motion-driven plant (inverse elastodynamic model, the paper's "perfect controller").

Inputs are the joint references; the unknowns are the elastic coordinates; the motor torques follow.
"""

from __future__ import annotations

import casadi

from flexfmu.model.five_bar import FiveBar, assemble
from flexfmu.model.plant_functions import (
    OutputRow,
    PlantEquations,
    compliance,
    elastic_names,
    elastic_scale,
    make_plant,
    moving_mass,
    output,
    reaction_outputs,
    robot_outputs,
    start_angles,
    start_parameters,
)
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicModel, Variable
from flexfmu.model.time_derivatives import Motion

REFERENCE_LOAD = 1.0
"""Acceleration [m/s²] whose static deflection is the floor of the error norm: smaller motions aren't resolved relative to
themselves."""

JOINT_INPUTS = (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s2"))


def motion_driven_plant(scene: Scene) -> SymbolicModel:
    """The plant of a scene as equations and variables."""
    five_bar = assemble(scene)
    start = start_parameters(five_bar, scene)
    inputs, m = _inputs(scene), five_bar.motion
    motion = Motion(m.q_e, m.v_e, m.a_e, casadi.vertcat(m.q_a, m.v_a, m.a_a))
    outputs = _torque_outputs(five_bar) + robot_outputs(five_bar)
    if scene.effects.reactions:
        outputs += reaction_outputs(five_bar.forces)
    equations = PlantEquations(
        motion=motion,
        residual=five_bar.forces.elastic,
        outputs=outputs,
        initial_inputs=casadi.vertcat(start_angles(five_bar, start, scene), casadi.SX.zeros(4)),
        initial_coordinates=casadi.SX.zeros(m.q_e.numel()),
        error_scale=_error_scale(five_bar),
    )
    return make_plant(
        scene,
        five_bar,
        equations,
        description="Flexible five-bar robot, motion-driven: joint references in, torques and end-effector motion out",
        unknowns=elastic_names(five_bar),
        inputs=inputs,
        rate_inputs=4,
    )


def _inputs(scene: Scene) -> tuple[Variable, ...]:
    joints = motor_angles(scene.mechanism, scene.trajectory.start)
    return tuple(
        Variable(
            f"joint{leg + 1}.reference.{kind}",
            unit,
            f"{kind.capitalize()} reference of motor {leg + 1}",
            "input",
            start=joints[leg] if kind == "position" else 0.0,
        )
        for kind, unit in JOINT_INPUTS
        for leg in range(2)
    )


def _torque_outputs(five_bar: FiveBar) -> list[OutputRow]:
    return [
        (
            output(f"joint{i + 1}.torque", "N.m", f"Torque of motor {i + 1}, counter-clockwise"),
            five_bar.forces.motors[i],
        )
        for i in range(2)
    ]


def _error_scale(five_bar: FiveBar) -> casadi.SX:
    """[kappa (n), mu (n), floor]: modal stiffness, modal mass and the elastic energy norm under the reference load."""
    kappa, mu = elastic_scale(five_bar)
    floor = REFERENCE_LOAD * moving_mass(five_bar) * casadi.sqrt(compliance(five_bar)) if kappa else casadi.SX(1)
    return casadi.vertcat(casadi.SX(0, 1), *kappa, *mu, floor)
