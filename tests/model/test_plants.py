"""Both plants against a formulation with multipliers, against each other, and their derivatives along motions."""

from __future__ import annotations

from collections.abc import Callable

import casadi
import numpy as np
import pytest

from flexfmu.cosim.studies.workprec.solver_trials import NUMBERS, index_one
from flexfmu.model.linear import linearize, operating_point
from flexfmu.model.multipliers import ConstrainedModel, constrained_model
from flexfmu.model.numeric import inverse_dynamics, numeric_model
from flexfmu.model.plants import build_model
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import FUNCTION_SIGNATURES, SymbolicModel

MOTORS = {
    "motor inertia and friction": {
        "effects.motor_inertia": 0.05,
        "effects.joint_friction": {"viscous": 0.3, "coulomb": 2.0, "velocity": 0.1},
    },
    "friction that sticks": {
        "effects.motor_inertia": 0.05,
        "effects.joint_friction": {"kind": "stiction", "coulomb": 2.0, "breakaway": 3.0, "stribeck_velocity": 2.0},
    },
    "elastic transmissions": {
        "effects.motor_inertia": 0.05,
        "effects.transmission": {"stiffness": 2e4, "damping": 3.0},
    },
}
"""What motors and joints add to the links."""

VARIANTS = {
    "the paper's robot": {},
    "tubes of steel without gravity": {
        "mechanism.proximal": {"length": 0.3, "diameter": 0.04, "inner_diameter": 0.03},
        "mechanism.material": {"density": 7850.0, "youngs_modulus": 210e9},
        "effects.gravity": [0.0, 0.0],
    },
    "every family, gravity sideways, stiffness damping": {
        "effects.gravity": [9.81, 0.0],
        "effects.proximal_axial": 2,
        "effects.distal_bending": 2,
        "effects.damping": {"kind": "stiffness", "time": 1e-4},
    },
    "foreshortening, payload that turns, Rayleigh damping": {
        "payload.inertia": 0.05,
        "effects.foreshortening": True,
        "effects.distal_bending": 2,
        "effects.damping": {"kind": "rayleigh", "rate": 20.0, "time": 1e-5},
    },
    "exact bending, thick beams": {
        "payload.inertia": 0.05,
        "effects.foreshortening": "exact",
        "effects.beam": "timoshenko",
        "effects.distal_bending": 1,
        "effects.damping": {"kind": "stiffness", "time": 1e-5},
    },
    "thick tubes, static shapes first": {
        "mechanism.proximal": {"length": 0.24, "diameter": 0.05, "inner_diameter": 0.03},
        "effects.beam": "timoshenko",
        "effects.basis": "craig-bampton",
        "effects.distal_bending": 1,
        "effects.proximal_axial": 1,
    },
    "elbows in, right assembly, no payload": {
        "mechanism.working_mode": "elbows-in",
        "mechanism.assembly_mode": "right",
        "payload.mass": 0.0,
    },
    "rigid": {"effects.proximal_bending": 0, "effects.distal_axial": 0},
    **MOTORS,
}


@pytest.fixture(params=VARIANTS.values(), ids=VARIANTS.keys())
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene("barnard2012-6kg").replace(request.param)


def random_states(scene: Scene, count: int = 20) -> list[tuple[np.ndarray, ...]]:
    """Seeded independent motions about poses on the path, with deflections of about a millimetre."""
    rng = np.random.default_rng(20120702)
    n = numeric_model(scene).n
    states = []
    for _ in range(count):
        position = (rng.uniform(-0.17, 0.17), rng.uniform(0.26, 0.33))
        q_a = np.array(motor_angles(scene.mechanism, position))
        q_e, v_e = rng.normal(size=n) * 1e-3, rng.normal(size=n) * 0.1
        states.append((q_a, rng.normal(size=2) * 5.0, rng.normal(size=2) * 50.0, q_e, v_e))
    return states


def minimal_solution(scene: Scene, q_a, v_a, a_a, q_e, v_e):  # type: ignore[no-untyped-def]
    model = numeric_model(scene)
    u = np.concatenate([q_a, v_a, a_a])
    bias = model.elastic_forces(q_e, v_e, np.zeros(model.n), u).full().ravel()
    a_e = -np.linalg.solve(model.mass_matrix(q_e, u).full(), bias) if model.n else np.empty(0)
    return a_e, [np.asarray(part.full()).ravel() for part in model.motion(q_e, v_e, a_e, u)]


def with_multipliers(model: ConstrainedModel, q, v, a_a):  # type: ignore[no-untyped-def]
    """Accelerations (10 + n,), joint reactions (8,) and motor torques (2,): the motors' accelerations are constraints too."""
    psi, mass = model.jacobian(q).full(), model.mass_matrix(q).full()
    rows = np.vstack([psi, np.eye(2, len(q))])
    kkt = np.block([[mass, rows.T], [rows, np.zeros((10, 10))]])
    right = np.concatenate([-model.bias(q, v).full(), -model.curvature(q, v).full(), a_a], axis=None)
    solution = np.linalg.solve(kkt, right)
    return solution[:-10], solution[-10:-2], -solution[-2:]


def test_both_formulations_have_the_same_accelerations_and_torques(scene: Scene) -> None:
    """Index reduction by closed-form assembly neither loses nor adds a force: accelerations to 1e-10, torques to 1e-9."""
    constrained = constrained_model(scene)
    for q_a, v_a, a_a, q_e, v_e in random_states(scene):
        a_e, (position, velocity, acceleration, torque) = minimal_solution(scene, q_a, v_a, a_a, q_e, v_e)
        q, v = (np.asarray(part.full()).ravel() for part in constrained.assembled(q_a, q_e, v_a, v_e))
        accelerations, _, expected = with_multipliers(constrained, q, v, a_a)
        # the closed form solves the paper's eq. (18) and its time derivative to rounding
        assert np.abs(constrained.constraints(q).full()).max() <= 1e-15
        assert np.abs(constrained.jacobian(q).full() @ v).max() <= 1e-13
        scale = max(1.0, np.abs(a_e).max(initial=0.0))
        assert np.abs(accelerations[2 : 2 + len(q_e)] - a_e).max(initial=0.0) <= 1e-10 * scale
        np.testing.assert_allclose(accelerations[-2:], acceleration, atol=1e-10 * scale)
        # the torques of elastic transmissions are differences of forces that belong to the largest accelerations
        rounding = 1e-13 * np.abs(accelerations).max() if scene.effects.transmission else 1e-9 * np.abs(torque).max()
        np.testing.assert_allclose(expected, torque, rtol=1e-9, atol=rounding)
        np.testing.assert_allclose(q[-2:], position, atol=1e-15)
        np.testing.assert_allclose(v[-2:], velocity, atol=1e-12)


def test_constraint_violations_decay_as_baumgarte_says(scene: Scene) -> None:
    """Off the constraint manifold the multipliers force f'' + 2 a f' + a² f = 0, which damps drift critically."""
    constrained, rate = constrained_model(scene), 100.0
    q_a, v_a, _, q_e, v_e = random_states(scene, 1)[0]
    q, v = (np.asarray(part.full()).ravel() for part in constrained.assembled(q_a, q_e, v_a, v_e))
    q[-2:] += 1e-5
    piece = np.eye(1, NUMBERS, 1)[0]  # from 0 to 1 s, motors at rest
    derivatives = index_one(constrained, rate)(0.0, np.concatenate([q, v]), piece).full().ravel()
    acceleration = derivatives[len(q) :]
    psi, f = constrained.jacobian(q).full(), constrained.constraints(q).full().ravel()
    second = psi @ acceleration + constrained.curvature(q, v).full().ravel()
    np.testing.assert_allclose(second, -2 * rate * psi @ v - rate**2 * f, atol=1e-9 * np.abs(acceleration).max())


POSE = (-0.1, 0.3)


def torque_scene(changes: dict[str, object] | None = None) -> Scene:
    return load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", **(changes or {})})


def derived(plant: SymbolicModel) -> casadi.DM:
    return plant.functions["derive"]([variable.start for variable in plant.parameters])


def acceleration(plant: SymbolicModel, y: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    bias = plant.functions["residual"](y, v, 0 * y, u, derived(plant)).full().ravel()
    return -np.linalg.solve(plant.functions["mass_matrix"](y, u, derived(plant)).full(), bias)


def outputs(plant: SymbolicModel, y: np.ndarray, v: np.ndarray, u: np.ndarray) -> dict[str, float]:
    values = plant.functions["outputs"](y, v, acceleration(plant, y, v, u), u, derived(plant)).full().ravel()
    return {variable.name: float(value) for variable, value in zip(plant.outputs, values, strict=True)}


def drawn(n: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Rates and accelerations of the motors, elastic coordinates and their rates."""
    sizes = ((2, 3.0), (2, 30.0), (n, 1e-4), (n, 1e-2))
    return tuple(rng.normal(size=count) * size for count, size in sizes)


DRIVES = {"links only": {}, **MOTORS, "reactions asked for": {"effects.reactions": True}}


@pytest.mark.parametrize("changes", DRIVES.values(), ids=DRIVES.keys())
def test_direct_and_inverse_model_are_inverses_of_each_other(changes: dict[str, object]) -> None:
    """The torques of the motion-driven plant give its accelerations back in the torque-driven one."""
    direct = build_model(torque_scene(changes))
    inverse = build_model(load_scene("barnard2012-6kg").replace(changes))
    n, rng = inverse.degrees_of_freedom, np.random.default_rng(11)
    for _ in range(5):
        q_a = np.array(motor_angles(torque_scene().mechanism, POSE))
        v_a, a_a, q_e, v_e = drawn(n, rng)
        u = np.concatenate([q_a, v_a, a_a])
        a_e = acceleration(inverse, q_e, v_e, u)
        torque = inverse.functions["outputs"](q_e, v_e, a_e, u, derived(inverse)).full().ravel()[:2]
        y, v = np.concatenate([q_a, q_e]), np.concatenate([v_a, v_e])
        applied = np.concatenate([torque, np.zeros(2)])
        found = acceleration(direct, y, v, applied)
        expected = np.concatenate([a_a, a_e])
        np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())
        # dry friction of motors that slip is an output too, by Stribeck's law
        if changes is DRIVES["friction that sticks"]:
            friction = [outputs(direct, y, v, applied)[f"joint{k}.friction"] for k in (1, 2)]
            assert friction == pytest.approx(-np.sign(v_a) * (2.0 + np.exp(-((v_a / 2.0) ** 2))), rel=1e-6)


def test_reactions_are_the_multipliers_of_the_constraints() -> None:
    """The joint reactions that the projection passes on are those of the other formulation, eq. (17)."""
    scene = load_scene("barnard2012-6kg").replace({"effects.reactions": True})
    plant, constrained = build_model(scene), constrained_model(scene)
    n, rng = plant.degrees_of_freedom, np.random.default_rng(13)
    q_a = np.array(motor_angles(scene.mechanism, POSE))
    v_a, a_a, q_e, v_e = drawn(n, rng)
    values = outputs(plant, q_e, v_e, np.concatenate([q_a, v_a, a_a]))
    q, v = (np.asarray(part.full()).ravel() for part in constrained.assembled(q_a, q_e, v_a, v_e))
    multipliers = with_multipliers(constrained, q, v, a_a)[1]
    names = ["leg1.reaction", "leg2.reaction", "elbow1.reaction", "elbow2.reaction"]
    reactions = [values[f"{name}.{axis}"] for name in names for axis in "xy"]
    np.testing.assert_allclose(reactions, -multipliers, atol=1e-9 * np.abs(multipliers).max())


def test_payload_accelerates_as_the_legs_pull_and_the_force_pushes() -> None:
    """Newton's law at the end effector: the legs' reactions, gravity and the external force move the payload."""
    plant = build_model(torque_scene({"effects.reactions": True}))
    point = operating_point(torque_scene(), POSE)
    force = np.array([30.0, -20.0])
    values = outputs(plant, point.coordinates, 0 * point.coordinates, point.inputs + np.array([0, 0, *force]))
    for axis, gravity, push in (("x", 0.0, force[0]), ("y", -9.81, force[1])):
        pulls = values[f"leg1.reaction.{axis}"] + values[f"leg2.reaction.{axis}"]
        assert 6.0 * (values[f"end_effector.acceleration.{axis}"] - gravity) == pytest.approx(pulls + push, abs=1e-9)


@pytest.mark.parametrize(
    ("friction", "dry"),
    [
        ({"viscous": 0.5, "coulomb": 3.0, "velocity": 0.2}, lambda w: 3.0 * w / np.hypot(w, 0.2)),
        (
            {"kind": "stiction", "viscous": 0.5, "coulomb": 3.0, "breakaway": 4.0, "stribeck_velocity": 0.2},
            lambda w: np.sign(w) * (3.0 + np.exp(-((w / 0.2) ** 2))),
        ),
    ],
    ids=["smooth", "sticking"],
)
def test_friction_follows_its_law(friction: dict[str, object], dry: Callable[[float], float]) -> None:
    """Viscous torque is linear; smooth Coulomb torque is c w / sqrt(w² + v²), at most c; that of a motor that sticks falls
    in slip from breakaway to Coulomb friction (Stribeck), and has no direction where a rate of zero is given."""
    base, rough = (
        inverse_dynamics(load_scene("barnard2012-6kg").replace({"effects.joint_friction": law}))
        for law in ({}, friction)
    )
    q, a = motor_angles(torque_scene().mechanism, POSE), [0.0, 0.0]
    for w in (-5.0, -0.1, 0.0, 0.01, 2.0):
        lost = (rough(q, [w, 0.0], a) - base(q, [w, 0.0], a)).full().ravel()
        assert lost == pytest.approx([0.5 * w + dry(w), 0.0], abs=1e-12)


def test_transmission_twists_under_load_and_vibrates_as_two_masses() -> None:
    """Statically the twist is torque / stiffness; a stiff spring's frequency is sqrt(k (1/J + 1/L)) of motor and robot."""
    rigid_links = {"effects.proximal_bending": 0, "effects.distal_axial": 0}
    scene = torque_scene({**rigid_links, "effects.motor_inertia": 0.05, "effects.transmission": {"stiffness": 1e5}})
    point = operating_point(scene, POSE)
    np.testing.assert_allclose(point.coordinates[2:], -point.inputs[:2] / 1e5, rtol=1e-3)
    # both inertias by the mass matrix of the rigid robot; gravity's stiffness is far below the springs'
    robot = build_model(torque_scene(rigid_links))
    links = robot.functions["mass_matrix"](point.coordinates[:2], point.inputs, derived(robot)).full()
    squares = np.linalg.eigvals(1e5 * (np.eye(2) / 0.05 + np.linalg.inv(links)))
    poles = linearize(scene, POSE).poles()
    found = np.unique(np.round(np.sort(np.abs(poles.imag)), 3))[-2:]
    np.testing.assert_allclose(found, np.sort(np.sqrt(squares)), rtol=2e-3)
    # a damper takes its coefficient times both inverse inertias
    damped = linearize(scene.replace({"effects.transmission": {"stiffness": 1e5, "damping": 3.0}}), POSE)
    assert np.trace(damped.A) == pytest.approx(-3.0 * (2.0 / 0.05 + np.trace(np.linalg.inv(links))), rel=1e-3)


def test_linearisation_predicts_small_responses() -> None:
    """The state-space system is the derivative of the plant: accelerations under small deviations agree."""
    scene = torque_scene()
    plant, point, system = build_model(scene), operating_point(scene, POSE), linearize(scene, POSE)
    n, rng = plant.degrees_of_freedom, np.random.default_rng(14)
    y, v, u = rng.normal(size=n) * 1e-7, rng.normal(size=n) * 1e-6, rng.normal(size=4) * 1e-3
    y[2:] *= 1e-3
    exact = acceleration(plant, point.coordinates + y, v, point.inputs + u)
    linear = system.A @ np.concatenate([y, v]) + system.B @ u
    np.testing.assert_allclose(linear[n:], exact, rtol=1e-3, atol=1e-6 * np.abs(exact).max())
    assert system.input_labels[:2] == ["joint1_torque", "joint2_torque"]
    assert "end_effector_position_x" in system.output_labels


def test_unknown_outputs_are_named() -> None:
    """A misspelt output of the linearisation is an error that lists what there is."""
    with pytest.raises(ValueError, match=r"no output `joint9\.position`; its outputs: joint1\.position"):
        linearize(torque_scene(), POSE, outputs=["joint9.position"])


@pytest.fixture(scope="module")
def plant() -> SymbolicModel:
    return build_model(load_scene("barnard2012-6kg"))


@pytest.fixture(scope="module")
def values(plant: SymbolicModel) -> np.ndarray:
    """The derived values."""
    return derived(plant).full().ravel()


class PolynomialMotion:
    """A smooth motion y(t), u(t) of degree 5 with known derivatives of every order."""

    def __init__(self, n: int) -> None:
        rng = np.random.default_rng(3)
        scale = 1e-4 * 100.0 ** np.arange(6)[:, None]
        self._y = rng.normal(size=(6, n)) * scale
        self._u = rng.normal(size=(6, 6)) * 0.1
        self._u[0, :2] = motor_angles(load_scene("barnard2012-6kg").mechanism, (-0.1, 0.3))

    def _derivative(self, coefficients: np.ndarray, t: float, order: int) -> np.ndarray:
        return np.polynomial.polynomial.polyval(t, np.polynomial.polynomial.polyder(coefficients, order))

    def y(self, t: float, order: int = 0) -> np.ndarray:
        return self._derivative(self._y, t, order)

    def u(self, t: float, order: int = 0) -> np.ndarray:
        return self._derivative(self._u, t, order)


def evaluate(plant: SymbolicModel, name: str, motion: PolynomialMotion, t: float, d: np.ndarray) -> np.ndarray:
    """A function of the plant along the motion, its arguments taken from the signature."""
    orders = {"y": 0, "v": 1, "a": 2, "j": 3, "dy": 1, "dv": 2}
    inputs = {"u": 0, "u1": 1, "u2": 2, "du": 1}
    values = [
        motion.y(t, orders[a]) if a in orders else motion.u(t, inputs[a]) if a in inputs else d * (a == "d")
        for a in FUNCTION_SIGNATURES[name][0]
    ]
    return plant.functions[name](*values).full().ravel()


def along(plant: SymbolicModel, motion: PolynomialMotion, t: float, d: np.ndarray, order: int) -> np.ndarray:
    """Residual and outputs along the motion, or their time derivatives of order 1 or 2."""
    if order == 0:
        return np.concatenate([evaluate(plant, name, motion, t, d) for name in ("residual", "outputs")])
    n, total = plant.degrees_of_freedom, plant.degrees_of_freedom + len(plant.outputs)
    changes = evaluate(plant, "motion_rate1", motion, t, d)
    by_acceleration = np.zeros((total, n))
    by_acceleration[:n] = plant.functions["mass_matrix"](motion.y(t), motion.u(t), d).full()
    for (output, unknown), entry in zip(plant.acceleration_terms, changes[total:], strict=True):
        by_acceleration[n + output, unknown] = entry
    held = changes[:total] if order == 1 else evaluate(plant, "motion_rate2", motion, t, d)
    return np.asarray(held + by_acceleration @ motion.y(t, 2 + order))


def test_first_rates_are_the_directional_derivatives_along_the_motion(plant: SymbolicModel, values: np.ndarray) -> None:
    """Taylor coefficients and forward differentiation are two ways to the same derivatives."""
    motion = PolynomialMotion(plant.degrees_of_freedom)
    rates, changes = (evaluate(plant, name, motion, 0.01, values) for name in ("motion_rate1", "motion_forward"))
    np.testing.assert_allclose(rates, changes, rtol=1e-9, atol=1e-12 * np.abs(changes).max())


@pytest.mark.parametrize("order", [1, 2])
def test_rates_are_the_time_derivatives_of_the_functions(plant: SymbolicModel, values: np.ndarray, order: int) -> None:
    """First and second rates agree with eighth-order differences along a motion with known derivatives."""
    motion, n = PolynomialMotion(plant.degrees_of_freedom), plant.degrees_of_freedom
    h, weights = 2e-4, np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    samples = np.array([along(plant, motion, k * h, values, order - 1) for k in range(-4, 5)])
    difference, exact = weights @ samples / h, along(plant, motion, 0.0, values, order)
    for part in (slice(n), slice(n, None)):
        largest = np.abs(samples[:, part]).max()
        np.testing.assert_allclose(exact[part], difference[part], rtol=1e-7, atol=1e-6 * largest)


def test_unset_references_start_at_the_start_pose(plant: SymbolicModel) -> None:
    """initial_inputs is the rigid inverse kinematics of start.x, start.y, also where these are changed."""
    scene = load_scene("barnard2012-6kg")
    values = {variable.name: variable.start for variable in plant.parameters}
    values["start.x"], values["start.y"] = 0.05, 0.3
    u = plant.functions["initial_inputs"](list(values.values())).full().ravel()
    np.testing.assert_allclose(u, [*motor_angles(scene.mechanism, (0.05, 0.3)), 0, 0, 0, 0], atol=1e-14)
    assert [variable.start for variable in plant.inputs[:2]] == list(
        motor_angles(scene.mechanism, scene.trajectory.start)
    )


def test_feedthrough_is_what_the_equations_say(plant: SymbolicModel) -> None:
    """Positions see position references only, velocities no acceleration, torques and accelerations everything."""
    kinds = {name: {i.rsplit(".", 1)[1] for i in inputs} for name, inputs in plant.feedthrough.items()}
    assert kinds["end_effector.position.x"] == {"position"}
    assert kinds["end_effector.velocity.y"] == {"position", "velocity"}
    assert kinds["joint1.torque"] == kinds["end_effector.acceleration.x"] == {"position", "velocity", "acceleration"}
    assert kinds["link11.bending[1]"] == kinds["link11.tip_deflection"] == set()
    assert kinds["der(link11.bending[1],2)"] == {"position", "velocity", "acceleration"}


def test_singularity_measure_is_the_sine_between_the_distal_links(plant: SymbolicModel, values: np.ndarray) -> None:
    """Undeformed, the measure is the rigid robot's; positive on the scene's assembly side."""
    from flexfmu.model.kinematics import RigidKinematics

    scene = load_scene("barnard2012-6kg")
    u = np.array([*motor_angles(scene.mechanism, (0.05, 0.3)), 0, 0, 0, 0])
    measure = float(plant.functions["singularity"](np.zeros(12), u, values))
    assert measure == pytest.approx(float(RigidKinematics(scene.mechanism).sine(np.array([[0.05, 0.3]]))[0]), rel=1e-12)
    assert measure > plant.minimum_margin
