"""The motion-driven plant (inverse elastodynamic model, the paper's "perfect controller").

Inputs are the joint references; the unknowns are the elastic coordinates; the motor torques follow.
"""

from __future__ import annotations

import casadi

from flexfmu.model.assembly import WORKING_MODES, motor_angles
from flexfmu.model.five_bar import FiveBar, assemble
from flexfmu.model.scene import Scene
from flexfmu.model.symbolic import SymbolicModel, Variable
from flexfmu.model.time_derivatives import Motion, along_motion

MINIMUM_SINE = 0.01
"""Smallest |sine| of the angle between the distal links that is simulated: half of what planning accepts, and still two
digits above where the elastic mass matrix loses its condition (3e5 at 0.026, 8e6 at 0.005)."""

REFERENCE_LOAD = 1.0
"""Acceleration [m/s²] whose static deflection is the floor of the error norm: smaller motions aren't resolved relative to
themselves."""

JOINT_INPUTS = (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s2"))


def motion_driven_plant(scene: Scene) -> SymbolicModel:
    """The plant of a scene as equations and variables."""
    five_bar = assemble(scene)
    start = _start_parameters(five_bar, scene)
    inputs = _inputs(scene)
    outputs = _outputs(five_bar)
    return SymbolicModel(
        name=scene.name,
        description="Flexible five-bar robot, motion-driven: joint references in, torques and end-effector motion out",
        unknowns=five_bar.robot.elastic_names,
        inputs=inputs,
        parameters=five_bar.registry.variables,
        outputs=tuple(variable for variable, _ in outputs),
        functions=_functions(five_bar, casadi.vertcat(*(casadi.SX(e) for _, e in outputs)), start, scene),
        feedthrough=_feedthrough(outputs, five_bar, inputs),
        static_start=scene.cosimulation.initial == "static",
        margin_name="sine of the angle between the distal links (type-2 singularity)",
        minimum_margin=MINIMUM_SINE,
        effects=five_bar.sentences,
    )


def _drive(five_bar: FiveBar) -> casadi.SX:
    """u = [q_a, v_a, a_a], shape (6, 1)."""
    motion = five_bar.motion
    return casadi.vertcat(motion.q_a, motion.v_a, motion.a_a)


def _functions(five_bar: FiveBar, outputs: casadi.SX, start: casadi.SX, scene: Scene) -> dict[str, casadi.Function]:
    """The functions of `flexfmu.model.symbolic.FUNCTION_SIGNATURES`."""
    motion, registry = five_bar.motion, five_bar.registry
    state = Motion(motion.q_e, motion.v_e, motion.a_e, _drive(five_bar))
    y, v, a, u, p, d = motion.q_e, motion.v_e, motion.a_e, state.u, registry.p, registry.d
    residual = five_bar.elastic_forces
    results = {
        "derive": ([p], registry.resolved()),
        "initial_inputs": ([p], _initial_inputs(five_bar, start, scene)),
        "initial_coordinates": ([p], casadi.SX.zeros(y.numel())),
        "residual": ([y, v, a, u, d], residual),
        "mass_matrix": ([y, u, d], casadi.jacobian(residual, a)),
        "outputs": ([y, v, a, u, d], outputs),
        "residual_rate": along_motion(state, residual, d, order=1),
        "residual_rate2": along_motion(state, residual, d, order=2),
        "outputs_rate": along_motion(state, outputs, d, order=1),
        "outputs_rate2": along_motion(state, outputs, d, order=2),
        "singularity": ([y, u, d], _side(scene) * five_bar.closure.sine),
        "error_scale": ([d], _error_scale(five_bar)),
    }
    return {
        name: casadi.Function(name, arguments, [casadi.densify(casadi.cse(casadi.densify(result)))])
        for name, (arguments, result) in results.items()
    }


def _side(scene: Scene) -> int:
    return 1 if scene.mechanism.assembly_mode == "left" else -1


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


def _start_parameters(five_bar: FiveBar, scene: Scene) -> casadi.SX:
    """Parameters start.x, start.y: the pose from which unset references start."""
    return casadi.vertcat(
        *(
            five_bar.registry.parameter(
                Variable(
                    f"start.{axis}", "m", f"Start pose, {axis} of the rigid end effector", "parameter", value, -1e3, 1e3
                )
            )
            for axis, value in zip("xy", scene.trajectory.start, strict=True)
        )
    )


def _initial_inputs(five_bar: FiveBar, start: casadi.SX, scene: Scene) -> casadi.SX:
    """u at the start pose, at rest, by rigid inverse kinematics in the scene's working mode."""
    p = {v.name: s for v, s in zip(five_bar.registry.variables, casadi.vertsplit(five_bar.registry.p), strict=True)}
    a, proximal, distal = p["base_half_distance"], p["proximal.length"], p["distal.length"]
    angles = []
    for base, sign in zip((-a, a), WORKING_MODES[scene.mechanism.working_mode], strict=True):
        dx, dy = start[0] - base, start[1]
        square = dx**2 + dy**2
        cosine = (proximal**2 + square - distal**2) / (2 * proximal * casadi.sqrt(square))
        angles.append(casadi.atan2(dy, dx) + sign * casadi.acos(cosine))
    return casadi.vertcat(*angles, casadi.SX.zeros(4))


def _outputs(five_bar: FiveBar) -> list[tuple[Variable, casadi.SX]]:
    """Outputs with their expressions: torques, end effector, the effects' scalars, elastic coordinates with derivatives."""
    closure, motion = five_bar.closure, five_bar.motion
    rows: list[tuple[Variable, casadi.SX]] = [
        (
            _output(f"joint{leg + 1}.torque", "N.m", f"Torque of motor {leg + 1}, counter-clockwise"),
            five_bar.motor_forces[leg],
        )
        for leg in range(2)
    ]
    for kind, unit, vector in (
        ("position", "m", closure.position),
        ("velocity", "m/s", closure.velocity),
        ("acceleration", "m/s2", closure.acceleration),
    ):
        for axis, component in zip("xy", casadi.vertsplit(vector), strict=True):
            rows.append(
                (_output(f"end_effector.{kind}.{axis}", unit, f"End effector, {axis} of the {kind}"), component)
            )
    rows += [
        (_output(o.name, o.unit, o.description[0].upper() + o.description[1:]), casadi.dot(o.gain, o.coordinates))
        for o in five_bar.outputs
    ]
    for k, name in enumerate(five_bar.robot.elastic_names):
        rate, acceleration = f"der({name})", f"der({name},2)"
        rows.append((_output(name, "m", "Modal coordinate of the paper's shape"), motion.q_e[k]))
        rows.append((_output(rate, "m/s", "Rate of the modal coordinate", of=name), motion.v_e[k]))
        rows.append((_output(acceleration, "m/s2", "Acceleration of the modal coordinate", of=rate), motion.a_e[k]))
    return rows


def _output(name: str, unit: str, description: str, of: str | None = None) -> Variable:
    return Variable(name, unit, description, "output", derivative_of=of)


def _feedthrough(
    outputs: list[tuple[Variable, casadi.SX]], five_bar: FiveBar, inputs: tuple[Variable, ...]
) -> dict[str, tuple[str, ...]]:
    """Inputs that each output depends on algebraically; elastic accelerations follow from all inputs."""
    motion, u = five_bar.motion, _drive(five_bar)
    names = [variable.name for variable in inputs]
    table = {}
    for variable, expression in outputs:
        everything = bool(motion.a_e.numel()) and casadi.depends_on(expression, motion.a_e)
        direct = (
            casadi.which_depends(expression, u, 1, False) if casadi.depends_on(expression, u) else [False] * len(names)
        )
        table[variable.name] = tuple(name for name, used in zip(names, direct, strict=True) if used or everything)
    return table


def _error_scale(five_bar: FiveBar) -> casadi.SX:
    """[kappa (n), mu (n), floor]: modal stiffness, modal mass and the elastic energy norm under the reference load."""
    parts = [part.family for _, part in five_bar.robot.elastic]
    kappa = [casadi.diag(family.stiffness) for family in parts]
    mu = [casadi.diag(family.mass) for family in parts]
    compliance = sum((casadi.sum1(family.tips**2 / casadi.diag(family.stiffness)) for family in parts), casadi.SX(0))
    find = five_bar.registry.find_derived
    mass = 2 * (find("proximal_mass") + find("distal_mass")) + find("payload_mass")
    floor = REFERENCE_LOAD * mass * casadi.sqrt(compliance) if parts else casadi.SX(1)
    return casadi.vertcat(casadi.SX(0, 1), *kappa, *mu, floor)
