"""The torque-driven plant (direct elastodynamic model): what controllers act on.

Inputs are the motor torques and a force at the end effector; the unknowns are the motor angles and the elastic
coordinates.
"""

from __future__ import annotations

import casadi

from flexfmu.model.five_bar import FiveBar, assemble
from flexfmu.model.plant_functions import (
    OutputRow,
    PlantEquations,
    elastic_names,
    elastic_scale,
    make_plant,
    output,
    reaction_outputs,
    robot_outputs,
    start_angles,
    start_parameters,
)
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium
from flexfmu.model.symbolic import Friction, SymbolicModel, Variable
from flexfmu.model.time_derivatives import Motion

RIGID_BANDWIDTH = 100.0
"""Rate [rad/s] that weighs a motor angle against its rate in the error norm of a robot without elasticity."""

REFERENCE_RATE = 0.1
"""Motor rate [rad/s] whose kinetic energy is the floor of the error norm: smaller motions aren't resolved relative to
themselves."""


def torque_driven_plant(scene: Scene) -> SymbolicModel:
    """The plant of a scene as equations and variables."""
    five_bar = assemble(scene)
    start = start_parameters(five_bar, scene)
    m = five_bar.motion
    torque, force = casadi.SX.sym("tau", 2), casadi.SX.sym("f", 2)
    motion = Motion(
        casadi.vertcat(m.q_a, m.q_e),
        casadi.vertcat(m.v_a, m.v_e),
        casadi.vertcat(m.a_a, m.a_e),
        casadi.vertcat(torque, force),
    )
    loaded = casadi.SX(five_bar.redundant_force)
    loaded[8:10] -= force
    five_bar = five_bar.with_forces(loaded)
    forces = five_bar.forces
    inputs = _inputs(scene)
    outputs = _joint_outputs(five_bar) + _friction_outputs(five_bar, torque) + robot_outputs(five_bar)
    if scene.effects.reactions:
        outputs += reaction_outputs(forces)
    equations = PlantEquations(
        motion=motion,
        residual=casadi.vertcat(forces.motors - torque, forces.elastic),
        outputs=outputs,
        initial_inputs=casadi.SX.zeros(4),
        initial_coordinates=casadi.vertcat(start_angles(five_bar, start, scene), casadi.SX.zeros(m.q_e.numel())),
        error_scale=_error_scale(five_bar),
    )
    return make_plant(
        scene,
        five_bar,
        equations,
        description="Flexible five-bar robot, torque-driven: motor torques in, joint and end-effector motion out",
        unknowns=("joint1.position", "joint2.position", *elastic_names(five_bar)),
        inputs=inputs,
        locked=2,
        frictions=_frictions(five_bar),
    )


def _inputs(scene: Scene) -> tuple[Variable, ...]:
    """Torques, which hold the start pose unless they are set, and the force at the end effector."""
    holding = static_equilibrium(scene, motor_angles(scene.mechanism, scene.trajectory.start)).torque
    torques = [
        Variable(
            f"joint{i + 1}.torque",
            "N.m",
            f"Torque of motor {i + 1}, counter-clockwise",
            "input",
            start=float(holding[i]),
        )
        for i in range(2)
    ]
    forces = [
        Variable(f"force.{axis}", "N", f"External force at the end effector, {axis}", "input", start=0.0)
        for axis in "xy"
    ]
    return (*torques, *forces)


def _joint_outputs(five_bar: FiveBar) -> list[OutputRow]:
    motion = five_bar.motion
    rows: list[OutputRow] = []
    for i in range(2):
        position, velocity, acceleration = (f"joint{i + 1}.{kind}" for kind in ("position", "velocity", "acceleration"))
        rows.append((output(position, "rad", f"Angle of motor {i + 1}"), motion.q_a[i]))
        rows.append((output(velocity, "rad/s", f"Rate of motor {i + 1}", of=position), motion.v_a[i]))
        rows.append((output(acceleration, "rad/s2", f"Acceleration of motor {i + 1}", of=velocity), motion.a_a[i]))
    return rows


def _friction_outputs(five_bar: FiveBar, torque: casadi.SX) -> list[OutputRow]:
    """What dry friction does to the motors: the law while they slip, what is left to hold them while they stick."""
    forces, rates = five_bar.forces.motors, five_bar.motion.v_a
    return [
        (
            output(f"joint{i + 1}.friction", "N.m", f"Torque of dry friction on motor {i + 1}, counter-clockwise"),
            forces[i] - torque[i] - friction.torque(rates[i]),
        )
        for i, friction in enumerate(five_bar.stiction)
    ]


def _frictions(five_bar: FiveBar) -> tuple[Friction, ...]:
    position = five_bar.registry.position
    return tuple(
        Friction(i, position(friction.breakaway), position(friction.direction))
        for i, friction in enumerate(five_bar.stiction)
    )


def _error_scale(five_bar: FiveBar) -> casadi.SX:
    """[kappa (2 + n), mu (2 + n), floor]: energy norm; a motor angle counts like the elbow's displacement that it makes."""
    kappa, mu = elastic_scale(five_bar)
    length, distal_mass = five_bar.links["proximal"].length, five_bar.links["distal"].mass
    proximal_inertia = five_bar.registry.find_derived("proximal_m_l2_3")
    inertia = proximal_inertia + (distal_mass + 0.5 * five_bar.end_effector_mass) * length**2
    bending = [part.family for _, part in five_bar.robot.elastic if part.family.direction == "bending"]
    stiffness = (
        bending[0].stiffness[0, 0] * (length / bending[0].shapes[0].tip) ** 2
        if bending and bending[0].shapes[0].tip
        else RIGID_BANDWIDTH**2 * inertia
    )
    floor = REFERENCE_RATE * casadi.sqrt(inertia)
    return casadi.vertcat(stiffness, stiffness, *kappa, inertia, inertia, *mu, floor)
