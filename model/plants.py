"""The two plants of a scene, built from the same five-bar, with drawing and notes for their documentation.

The motion-driven plant is the inverse elastodynamic model, the paper's "perfect controller": inputs are the joint
references, unknowns are the elastic coordinates q_e, and the motor torques are outputs. The torque-driven plant is the
direct elastodynamic model for control loops: inputs are the motor torques and a force at the end effector, unknowns are
[q_a, q_e].
"""

from __future__ import annotations

from dataclasses import replace

import casadi

from flexfmu.model.choice_text import choice_notes
from flexfmu.model.five_bar import FiveBar, assemble
from flexfmu.model.plant_functions import (
    OutputRow,
    PlantEquations,
    compliance,
    elastic_names,
    elastic_scale,
    make_plant,
    output,
    reaction_outputs,
    robot_outputs,
    start_angles,
    start_parameters,
)
from flexfmu.model.scene.assembly import bases, elbows, motor_angles
from flexfmu.model.scene.disturbances import PAYLOAD, disturbance_inputs
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium
from flexfmu.model.symbolic import Bar, Drawing, Friction, Spot, SymbolicModel, Variable
from flexfmu.model.time_derivatives import MotionSymbols

REFERENCE_LOAD = 1.0
"""Acceleration [m/s²] whose static deflection is the floor of the motion-driven error norm: the tolerance of smaller
motions is absolute."""

REFERENCE_RATE = 0.1
"""Motor rate [rad/s] whose kinetic energy is the floor of the torque-driven error norm, for the same reason."""

RIGID_BANDWIDTH = 100.0
"""Angular frequency [rad/s] that weighs motor angles against their rates in the error norm where no tip bends."""


def build_model(scene: Scene) -> SymbolicModel:
    """The plant of a scene, torque-driven or motion-driven, as equations and variables."""
    model = torque_driven_plant(scene) if scene.cosimulation.drive == "torque" else motion_driven_plant(scene)
    return replace(model, drawing=draw_five_bar(scene), effects=(*model.effects, *choice_notes(scene)))


def draw_five_bar(scene: Scene) -> Drawing:
    """Drawing of the undeformed robot at the start of the path."""
    mechanism, end = scene.mechanism, scene.start
    bars: list[Bar] = []
    spots: list[Spot] = []
    for leg, (base, elbow) in enumerate(zip(bases(mechanism), elbows(mechanism, end), strict=True), start=1):
        bars.append(Bar(f"link{leg}1", "proximal", base, elbow, mechanism.proximal.diameter))
        bars.append(Bar(f"link{leg}2", "distal", elbow, end, mechanism.distal.diameter))
        spots += [Spot(f"joint{leg}", "motor", base), Spot(f"elbow{leg}", "joint", elbow)]
    return Drawing(tuple(bars), (*spots, Spot("end_effector", "end effector", end)))


def motion_driven_plant(scene: Scene) -> SymbolicModel:
    """The motion-driven plant of a scene; its residual is the force on the elastic coordinates."""
    five_bar = assemble(scene)
    start, m = start_parameters(five_bar, scene), five_bar.motion
    # outputs: motor torques, then the motion of the robot
    outputs: list[OutputRow] = [
        (output(f"joint{i + 1}.torque", "N.m", _TORQUE.format(i + 1)), five_bar.forces.motors[i]) for i in range(2)
    ]
    outputs += robot_outputs(five_bar)
    if scene.effects.reactions:
        outputs += reaction_outputs(five_bar.forces)
    # error norm: elastic energy; its floor is the energy under the reference load
    kappa, mu = elastic_scale(five_bar)
    mass = 2 * (five_bar.links["proximal"].mass + five_bar.links["distal"].mass) + five_bar.end_effector_mass
    floor = REFERENCE_LOAD * mass * casadi.sqrt(compliance(five_bar)) if kappa else casadi.SX(1)
    equations = PlantEquations(
        motion=MotionSymbols(m.q_e, m.v_e, m.a_e, casadi.vertcat(m.q_a, m.v_a, m.a_a)),
        residual=five_bar.forces.elastic,
        outputs=outputs,
        initial_inputs=casadi.vertcat(start_angles(five_bar, start, scene), casadi.SX.zeros(4)),
        initial_coordinates=casadi.SX.zeros(m.q_e.numel()),
        error_scale=casadi.vertcat(casadi.SX(0, 1), *kappa, *mu, floor),
    )
    return make_plant(
        scene,
        five_bar,
        equations,
        description="Flexible five-bar robot, motion-driven: joint references in, torques and end-effector motion out",
        unknowns=elastic_names(five_bar),
        inputs=_reference_inputs(scene),
        rate_inputs=4,
    )


def _reference_inputs(scene: Scene) -> tuple[Variable, ...]:
    """Inputs for the references of both joints, at rest in the start pose."""
    joints = motor_angles(scene.mechanism, scene.start)
    return tuple(
        Variable(
            f"joint{leg + 1}.reference.{kind}",
            unit,
            f"{kind.capitalize()} reference of motor {leg + 1}",
            "input",
            start=joints[leg] if kind == "position" else 0.0,
        )
        for kind, unit in (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s2"))
        for leg in range(2)
    )


_TORQUE = "Torque of motor {}, counter-clockwise"


def torque_driven_plant(scene: Scene) -> SymbolicModel:
    """The torque-driven plant of a scene; its residual is the force on motor angles and elastic coordinates."""
    five_bar = assemble(scene)
    start, m = start_parameters(five_bar, scene), five_bar.motion
    torque, force = casadi.SX.sym("tau", 2), casadi.SX.sym("f", 2)
    disturbances = disturbance_inputs(scene.disturbance)
    disturbed = casadi.SX.sym("d", len(disturbances))
    acting = torque + disturbed[:2] if "joint1.disturbance" in disturbances else torque
    # the external force at the end effector reduces the required force there
    loaded = casadi.SX(five_bar.redundant_force)
    loaded[8:10] -= force
    five_bar = five_bar.with_forces(loaded)
    outputs = _joint_outputs(five_bar, acting)
    outputs += robot_outputs(five_bar)
    if scene.effects.reactions:
        outputs += reaction_outputs(five_bar.forces)
    equations = PlantEquations(
        motion=MotionSymbols(
            casadi.vertcat(m.q_a, m.q_e),
            casadi.vertcat(m.v_a, m.v_e),
            casadi.vertcat(m.a_a, m.a_e),
            casadi.vertcat(torque, force, disturbed),
        ),
        residual=casadi.vertcat(five_bar.forces.motors - acting, five_bar.forces.elastic),
        outputs=outputs,
        initial_inputs=casadi.SX.zeros(4 + len(disturbances)),
        initial_coordinates=casadi.vertcat(start_angles(five_bar, start, scene), casadi.SX.zeros(m.q_e.numel())),
        error_scale=_torque_driven_scale(five_bar),
    )
    if PAYLOAD in disturbances:
        equations = _with_payload_change(equations, five_bar.registry.find_derived("payload_mass"), disturbed[-1])
    position_of = five_bar.registry.position
    return make_plant(
        scene,
        five_bar,
        equations,
        description="Flexible five-bar robot, torque-driven: motor torques in, joint and end-effector motion out",
        unknowns=("joint1.position", "joint2.position", *elastic_names(five_bar)),
        inputs=_torque_inputs(scene),
        locked=2,
        frictions=tuple(
            Friction(i, position_of(friction.breakaway), position_of(friction.direction))
            for i, friction in enumerate(five_bar.stiction)
        ),
    )


def _joint_outputs(five_bar: FiveBar, torque: casadi.SX) -> list[OutputRow]:
    """Outputs for the motion of the motors and their dry friction."""
    motion = five_bar.motion
    rows: list[OutputRow] = []
    for i in range(2):
        position, velocity, acceleration = (f"joint{i + 1}.{kind}" for kind in ("position", "velocity", "acceleration"))
        rows.append((output(position, "rad", f"Angle of motor {i + 1}"), motion.q_a[i]))
        rows.append((output(velocity, "rad/s", f"Rate of motor {i + 1}", of=position), motion.v_a[i]))
        rows.append((output(acceleration, "rad/s2", f"Acceleration of motor {i + 1}", of=velocity), motion.a_a[i]))
    # dry friction is the part of a motor's torque that its motion doesn't need
    for i, friction in enumerate(five_bar.stiction):
        text = f"Torque of dry friction on motor {i + 1}, counter-clockwise"
        left = five_bar.forces.motors[i] - torque[i] - friction.torque(motion.v_a[i])
        rows.append((output(f"joint{i + 1}.friction", "N.m", text), left))
    return rows


def _torque_inputs(scene: Scene) -> tuple[Variable, ...]:
    """Inputs for torques, by default those that hold the start pose, and for the force at the end effector."""
    holding = static_equilibrium(scene, motor_angles(scene.mechanism, scene.start)).torque
    torques = [
        Variable(f"joint{i + 1}.torque", "N.m", _TORQUE.format(i + 1), "input", start=float(holding[i]))
        for i in range(2)
    ]
    text = "External force at the end effector, {}"
    forces = [Variable(f"force.{axis}", "N", text.format(axis), "input", start=0.0) for axis in "xy"]
    # inputs of disturbances, where the scene has some
    units = {PAYLOAD: ("kg", "Mass picked up, negative for mass dropped; it has the velocity of the end effector")}
    units |= {f"joint{i}.disturbance": ("N.m", f"Disturbance torque on motor {i}, counter-clockwise") for i in (1, 2)}
    disturbances = [Variable(name, *units[name], "input", start=0.0) for name in disturbance_inputs(scene.disturbance)]
    return (*torques, *forces, *disturbances)


def _with_payload_change(equations: PlantEquations, mass: casadi.SX, change: casadi.SX) -> PlantEquations:
    """The equations with a payload of mass + change [kg]; the error norm keeps the mass."""
    residual = casadi.substitute(equations.residual, mass, mass + change)
    outputs = [(each, casadi.substitute(casadi.SX(value), mass, mass + change)) for each, value in equations.outputs]
    return replace(equations, residual=residual, outputs=outputs)


def _torque_driven_scale(five_bar: FiveBar) -> casadi.SX:
    """Weights [kappa (2 + n), mu (2 + n), floor] of the energy norm; a motor angle counts as elbow displacement."""
    kappa, mu = elastic_scale(five_bar)
    # inertia of a motor angle: its proximal link, and a distal link with half of the payload at the elbow
    length, distal_mass = five_bar.links["proximal"].length, five_bar.links["distal"].mass
    proximal_inertia = five_bar.registry.find_derived("proximal_m_l2_3")
    inertia = proximal_inertia + (distal_mass + 0.5 * five_bar.end_effector_mass) * length**2
    # stiffness: that of the first bending mode at its tip, or from a nominal bandwidth where no tip bends
    bending = [part.family for _, part in five_bar.robot.elastic if part.family.direction == "bending"]
    stiffness = (
        bending[0].stiffness[0, 0] * (length / bending[0].shapes[0].tip) ** 2
        if bending and bending[0].shapes[0].tip
        else RIGID_BANDWIDTH**2 * inertia
    )
    floor = REFERENCE_RATE * casadi.sqrt(inertia)
    return casadi.vertcat(stiffness, stiffness, *kappa, inertia, inertia, *mu, floor)
