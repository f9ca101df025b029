"""The two plants of a scene, built from the same five-bar, with drawing and notes for their documentation.

The motion-driven plant is the inverse elastodynamic model, the paper's "perfect controller": inputs are the joint
references, unknowns are the elastic coordinates q_e, and the motor torques are outputs. The torque-driven plant is the
direct elastodynamic model for control loops: inputs are the motor torques and a force at the end effector, unknowns are
[q_a, q_e].
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi
import numpy as np

from flexfmu.model import time_derivatives
from flexfmu.model.choice_text import choice_notes
from flexfmu.model.closure import ProjectedForces
from flexfmu.model.contract import contract_functions
from flexfmu.model.five_bar import FiveBar, assemble
from flexfmu.model.robot import Family
from flexfmu.model.scene.assembly import WORKING_MODES, bases, elbows, motor_angles
from flexfmu.model.scene.disturbances import PAYLOAD, disturbance_inputs
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium
from flexfmu.model.symbolic import Bar, Drawing, Friction, Spot, SymbolicModel, Variable

MINIMUM_SINE = 0.01
"""Smallest |sine| of the angle between the distal links in a simulation: half of the limit for planning.
The condition number of the elastic mass matrix is 3e5 at 0.026 and 8e6 at 0.005."""

MARGIN_NAME = "sine of the angle between the distal links (type-2 singularity)"

MIDDLE = np.array([0.5])
"""Position on a link (fraction of its length) for shapes without tip displacement."""

POSE = ("end_effector.position.x", "end_effector.position.y")
"""Outputs that give the pose of the robot in messages."""

OutputRow = tuple[Variable, casadi.SX]


@dataclass(frozen=True)
class PlantEquations:
    """The equations of a plant as expressions.

    Attributes:
        description, locked, rate_inputs, frictions: as in `SymbolicModel`.
        unknowns: names of y.
        inputs: variables of u.
        motion: unknowns y, their rates and accelerations, and inputs u.
        residual: r(y, v, a, u), (n, 1).
        outputs: output variables with their expressions.
        initial_inputs: start values of u, expression of the parameters.
        initial_coordinates: start values of y, undeformed, expression of the parameters.
        error_scale: weights [kappa (n), mu (n), floor] of the error norm, expression of the derived values.
    """

    description: str
    unknowns: tuple[str, ...]
    inputs: tuple[Variable, ...]
    motion: time_derivatives.MotionSymbols
    residual: casadi.SX
    outputs: Sequence[OutputRow]
    initial_inputs: casadi.SX
    initial_coordinates: casadi.SX
    error_scale: casadi.SX
    locked: int = 0
    rate_inputs: int = 0
    frictions: tuple[Friction, ...] = ()


def make_plant(scene: Scene, five_bar: FiveBar, equations: PlantEquations) -> SymbolicModel:
    """The symbolic model of a plant."""
    motion, residual = equations.motion, equations.residual
    outputs = casadi.vertcat(*(casadi.SX(expression) for _, expression in equations.outputs))
    derived = five_bar.registry.resolved()
    side = 1 if scene.mechanism.assembly_mode == "left" else -1
    return SymbolicModel(
        name=scene.name,
        description=equations.description,
        unknowns=equations.unknowns,
        inputs=equations.inputs,
        parameters=five_bar.registry.variables,
        outputs=tuple(variable for variable, _ in equations.outputs),
        functions=contract_functions(
            motion,
            residual,
            outputs,
            (five_bar.registry.p, five_bar.registry.d),
            (derived, equations.initial_inputs, equations.initial_coordinates),
            side * five_bar.closure.sine,
            equations.error_scale,
        ),
        acceleration_terms=time_derivatives.acceleration_terms(motion, outputs),
        feedthrough=_feedthrough(equations),
        static_start=scene.cosimulation.initial == "static",
        margin_name=MARGIN_NAME,
        minimum_margin=MINIMUM_SINE,
        is_damped=five_bar.dynamics.is_damped,
        locked=equations.locked,
        rate_inputs=equations.rate_inputs,
        twin_unknowns=_twins(equations.unknowns),
        twin_inputs=_twins([variable.name for variable in equations.inputs]),
        frictions=equations.frictions,
        effects=five_bar.notes,
        pose=POSE,
    )


def _twins(names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Indices of the names of leg 1 and their counterparts of leg 2, as ``link11.bending[1]`` and ``link21.bending[1]``."""
    mirrored = [re.sub(r"^([a-z]+)1", r"\g<1>2", name) for name in names]
    return tuple((k, names.index(name)) for k, name in enumerate(mirrored) if name != names[k] and name in names)


def start_parameters(five_bar: FiveBar, scene: Scene) -> casadi.SX:
    """Symbols (2, 1) of the parameters start.x and start.y: the start pose [m]."""
    return casadi.vertcat(
        *(
            five_bar.registry.parameter(
                Variable(
                    f"start.{axis}", "m", f"Start pose, {axis} of the rigid end effector", "parameter", value, -1e3, 1e3
                )
            )
            for axis, value in zip("xy", scene.start, strict=True)
        )
    )


def start_angles(five_bar: FiveBar, start: casadi.SX, scene: Scene) -> casadi.SX:
    """Motor angles (2, 1) at the start pose by rigid inverse kinematics in the scene's working mode."""
    # parameters, not derived values, which are computed later
    p = {v.name: s for v, s in zip(five_bar.registry.variables, casadi.vertsplit(five_bar.registry.p), strict=True)}
    a, proximal, distal = p["base_half_distance"], p["proximal.length"], p["distal.length"]
    angles = []
    # law of cosines in the triangle base, elbow, end effector
    for base, sign in zip((-a, a), WORKING_MODES[scene.mechanism.working_mode], strict=True):
        dx, dy = start[0] - base, start[1]
        square = dx**2 + dy**2
        cosine = (proximal**2 + square - distal**2) / (2 * proximal * casadi.sqrt(square))
        angles.append(casadi.atan2(dy, dx) + sign * casadi.acos(cosine))
    return casadi.vertcat(*angles)


def output(name: str, unit: str, description: str, of: str | None = None) -> Variable:
    """An output variable; `of` names the output whose time derivative it is."""
    return Variable(name, unit, description, "output", derivative_of=of)


def robot_outputs(five_bar: FiveBar) -> list[OutputRow]:
    """Outputs of the robot: end effector, effects, and elastic coordinates with their derivatives."""
    closure, motion = five_bar.closure, five_bar.motion
    rows: list[OutputRow] = []
    # motion of the end effector
    for kind, unit, vector in (
        ("position", "m", five_bar.position),
        ("velocity", "m/s", closure.velocity),
        ("acceleration", "m/s2", closure.acceleration),
    ):
        rows += _components(f"end_effector.{kind}", unit, f"End effector, {{}} of the {kind}", vector)
    # outputs of the effects, static deflections included
    for each in five_bar.outputs:
        value = casadi.dot(each.gain, each.coordinates)
        if five_bar.partition.statics:
            value = casadi.substitute(value, five_bar.robot.q_e, five_bar.elastic)
        rows.append((output(each.name, each.unit, each.description[0].upper() + each.description[1:]), value))
    # elastic coordinates with their rates and accelerations
    robot, states = five_bar.robot, five_bar.partition.states
    units, texts = robot.elastic_units, robot.elastic_texts
    for k, (name, i) in enumerate(zip(elastic_names(five_bar), states, strict=True)):
        unit, text = units[i], texts[i]
        rate, acceleration = f"der({name})", f"der({name},2)"
        rows.append((output(name, unit, text), motion.q_e[k]))
        rows.append((output(rate, f"{unit}/s", f"Rate of {name}", of=name), motion.v_e[k]))
        rows.append((output(acceleration, f"{unit}/s2", f"Acceleration of {name}", of=rate), motion.a_e[k]))
    return rows


def elastic_names(five_bar: FiveBar) -> tuple[str, ...]:
    """Names of the elastic coordinates that are states."""
    return tuple(five_bar.robot.elastic_names[i] for i in five_bar.partition.states)


def reaction_outputs(forces: ProjectedForces) -> list[OutputRow]:
    """Outputs for the joint reaction forces of both legs."""
    rows: list[OutputRow] = []
    for leg in (1, 2):
        elbow, pull = forces.elbows[leg - 1], forces.pulls[leg - 1]
        rows += _components(
            f"elbow{leg}.reaction", "N", f"Force of link {leg}1 on link {leg}2 at the elbow, {{}}", elbow
        )
        rows += _components(f"leg{leg}.reaction", "N", f"Force of leg {leg} on the end effector, {{}}", pull)
    return rows


def _components(name: str, unit: str, text: str, vector: casadi.SX) -> list[OutputRow]:
    parts = zip("xy", casadi.vertsplit(vector), strict=True)
    return [(output(f"{name}.{axis}", unit, text.format(axis)), component) for axis, component in parts]


def _feedthrough(equations: PlantEquations) -> Mapping[str, tuple[str, ...]]:
    """Output → inputs with direct feedthrough; accelerations depend on all inputs."""
    names, motion = [variable.name for variable in equations.inputs], equations.motion
    table = {}
    for variable, expression in equations.outputs:
        everything = bool(motion.a.numel()) and casadi.depends_on(expression, motion.a)
        depends = casadi.depends_on(expression, motion.u)
        direct = casadi.which_depends(expression, motion.u, 1, False) if depends else [False] * len(names)
        table[variable.name] = tuple(name for name, used in zip(names, direct, strict=True) if used or everything)
    return table


def elastic_scale(five_bar: FiveBar) -> tuple[list[casadi.SX], list[casadi.SX]]:
    """Modal stiffnesses and masses of the elastic states, as lists of column vectors, for the error norm."""
    families = _vibrating(five_bar)
    kappa = [casadi.diag(family.stiffness) for family in families]
    mu = [casadi.diag(family.mass) for family in families]
    if five_bar.joint_stiffness is not None:
        kappa.append(casadi.repmat(five_bar.joint_stiffness, 2, 1))
        mu.append(casadi.repmat(five_bar.registry.find_derived("proximal_m_l2_3"), 2, 1))
    return kappa, mu


def _vibrating(five_bar: FiveBar) -> list[Family]:
    """The families of all links that are states, without the quasi-static ones."""
    return [part.family for _, part in five_bar.robot.elastic if not part.family.quasi_static]


def compliance(five_bar: FiveBar) -> casadi.SX:
    """Sum of the modal compliances at the tips [m/N], or at mid-length where no tip moves; zero for a rigid robot."""
    families = _vibrating(five_bar)
    # compliance of the links
    moves = any(shape.tip for family in families for shape in family.shapes)
    total = casadi.SX(0)
    for family in families:
        reach = family.tips if moves else casadi.DM([float(shape.value(MIDDLE)[0]) for shape in family.shapes])
        total += casadi.sum1(reach**2 / casadi.diag(family.stiffness))
    # compliance of the transmissions, at the elbows
    if five_bar.joint_stiffness is not None:
        total += five_bar.links["proximal"].length ** 2 / five_bar.joint_stiffness
    return total


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
        description="Flexible five-bar robot, motion-driven: joint references in, torques and end-effector motion out",
        unknowns=elastic_names(five_bar),
        inputs=_reference_inputs(scene),
        rate_inputs=4,
        motion=time_derivatives.MotionSymbols(m.q_e, m.v_e, m.a_e, casadi.vertcat(m.q_a, m.v_a, m.a_a)),
        residual=five_bar.forces.elastic,
        outputs=outputs,
        initial_inputs=casadi.vertcat(start_angles(five_bar, start, scene), casadi.SX.zeros(4)),
        initial_coordinates=casadi.SX.zeros(m.q_e.numel()),
        error_scale=casadi.vertcat(casadi.SX(0, 1), *kappa, *mu, floor),
    )
    return make_plant(scene, five_bar, equations)


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
    position_of = five_bar.registry.position
    equations = PlantEquations(
        description="Flexible five-bar robot, torque-driven: motor torques in, joint and end-effector motion out",
        unknowns=("joint1.position", "joint2.position", *elastic_names(five_bar)),
        inputs=_torque_inputs(scene),
        locked=2,
        frictions=tuple(
            Friction(i, position_of(friction.breakaway), position_of(friction.direction))
            for i, friction in enumerate(five_bar.stiction)
        ),
        motion=time_derivatives.MotionSymbols(
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
    return make_plant(scene, five_bar, equations)


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
