"""Kinematics, equations of motion and energies against closed forms and physical laws; static families against vibrating ones; NumPy
against CasADi."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import casadi
import numpy as np
import pytest
from scipy.optimize import root

from flexfmu.cosim.control.blocks.code import CompiledAtPoints
from flexfmu.model import link_effects, vectorised
from flexfmu.model.beams import scene_shapes
from flexfmu.model.five_bar import assemble
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.numeric import numeric_model, standstill
from flexfmu.model.plants import build_model
from flexfmu.model.scene.assembly import WORKING_MODES, assembly_side, elbows, motor_angles
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies, static_equilibrium
from flexfmu.model.vectorised import Vectorised
from flexfmu.trajectories.jets import Jet


def kinematics(working_mode: str = "elbows-out") -> RigidKinematics:
    mechanism = load_scene("barnard2012-6kg").mechanism.model_copy(update={"working_mode": working_mode})
    side = "left" if assembly_side(*elbows(mechanism, (0.03, 0.3)), (0.03, 0.3)) > 0 else "right"
    return RigidKinematics(mechanism.model_copy(update={"assembly_mode": side}))


@pytest.mark.parametrize("working_mode", WORKING_MODES)
def test_inverse_kinematics_closes_both_legs(working_mode: str) -> None:
    """In every working mode the elbows are at the proximal length from the bases and at the distal length from the tip."""
    robot, position = kinematics(working_mode), np.array([0.03, 0.3])
    a = robot.mechanism.base_half_distance
    for base, elbow, angle in zip(
        [(-a, 0), (a, 0)], elbows(robot.mechanism, (0.03, 0.3)), motor_angles(robot.mechanism, (0.03, 0.3)), strict=True
    ):
        np.testing.assert_allclose(
            np.subtract(elbow, base), 0.24 * np.array([np.cos(angle), np.sin(angle)]), atol=1e-15
        )
        assert np.hypot(*(position - elbow)) == pytest.approx(0.38079, rel=1e-14)


@pytest.mark.parametrize("working_mode", WORKING_MODES)
def test_joint_jets_are_the_derivatives_of_the_inverse(working_mode: str) -> None:
    """Jets to order 4 along a curve agree with a Taylor expansion of the inverse itself."""
    robot = kinematics(working_mode)
    x = Jet.from_derivatives(np.array([0.03, 1.2, -3.0, 8.0, 20.0]))
    y = Jet.from_derivatives(np.array([0.30, -0.4, 5.0, -9.0, 10.0]))
    q11, q21 = robot.joints(x, y)
    t = 1e-3
    powers = t ** np.arange(5)
    exact = motor_angles(robot.mechanism, (float(x.coefficients @ powers), float(y.coefficients @ powers)))
    np.testing.assert_allclose([q11.coefficients @ powers, q21.coefficients @ powers], exact, atol=1e-11)


def test_margins_fall_to_zero_where_the_leg_is_stretched_and_the_elbows_meet() -> None:
    """Reach margins are distances to the two circles; the sine is undefined out of reach."""
    robot = kinematics()
    stretched = -0.1 + 0.24 + 0.38079 - 0.01
    reach1, reach2, sine = robot.margins(np.array([[stretched, 0.0], [0.03, 0.3], [0.0, 2.0]]))
    assert reach1.values[0] == pytest.approx(0.01, rel=1e-9)
    assert np.all(np.array([reach1.values[1], reach2.values[1], sine.values[1]]) > 0.05)
    assert reach1.values[2] < 0.0
    assert np.isnan(sine.values[2])


POSES = [(-0.175, 0.320), (-0.175, 0.300), (-0.1, 0.295), (0.0, 0.295), (0.1, 0.295), (0.175, 0.320)]


@pytest.fixture(scope="module")
def heavy() -> Scene:
    return load_scene("barnard2012-6kg")


@pytest.mark.parametrize(
    ("payload", "mode", "lowest", "highest", "digits"),
    [("6", 0, 56.8, 58.8, 1), ("0.1", 0, 124.1, 128.4, 1), ("0.1", 2, 1905.0, 1920.0, 0)],
)
def test_frequencies_lie_in_the_papers_bands(
    payload: str, mode: int, lowest: float, highest: float, digits: int
) -> None:
    """58 ± 1 Hz with 6 kg, 126 ± 2 Hz and 1912 ± 7.5 Hz with 0.1 kg, with the rounding of an independent reproduction."""
    scene = load_scene(f"barnard2012-{payload}kg")
    found = [natural_frequencies(scene, motor_angles(scene.mechanism, pose))[mode] for pose in POSES]
    assert lowest <= round(min(found), digits) <= round(max(found), digits) <= highest


def test_holding_torque_is_the_gradient_of_the_total_potential_energy(heavy: Scene) -> None:
    """Virtual work at equilibrium: tau = dV/dq_a with the elastic coordinates in equilibrium."""
    joints = np.array(motor_angles(heavy.mechanism, (-0.1, 0.3)))
    model, step = numeric_model(heavy), 1e-4

    def potential(q: np.ndarray) -> float:
        elastic = static_equilibrium(heavy, q).elastic
        return float(model.energy(elastic, np.zeros(model.n), standstill(q))[1])

    gradient = [(potential(joints + step * e) - potential(joints - step * e)) / (2 * step) for e in np.eye(2)]
    np.testing.assert_allclose(static_equilibrium(heavy, joints).torque, gradient, rtol=1e-6)


EVERYTHING = {
    "payload.inertia": 0.05,
    "effects.beam": "timoshenko",
    "effects.foreshortening": True,
    "effects.distal_bending": 1,
    "effects.damping": {"kind": "rayleigh", "rate": 20.0, "time": 1e-5},
}


@pytest.mark.parametrize("changes", [{}, EVERYTHING], ids=["the paper's", "everything"])
@pytest.mark.parametrize("seed", range(10))
def test_power_balance(heavy: Scene, seed: int, changes: dict[str, object]) -> None:
    """dE/dt = tau·w - 2 R at random states: the torques are consistent with the energies."""
    heavy = heavy.replace(changes)
    model = numeric_model(heavy)
    undamped = numeric_model(heavy.replace({"effects.damping": {"kind": "none"}}))
    rng = np.random.default_rng(seed)
    joints = np.array(motor_angles(heavy.mechanism, (0.05, 0.3)))
    w, alpha = rng.normal(size=2) * 5, rng.normal(size=2) * 50
    q, v = rng.normal(size=model.n) * 1e-4, rng.normal(size=model.n) * 1e-2
    u = np.concatenate([joints, w, alpha])
    bias = model.elastic_forces(q, v, np.zeros(model.n), u).full().ravel()
    a = -np.linalg.solve(model.mass_matrix(q, u).full(), bias)
    torque = np.asarray(model.motion(q, v, a, u)[3].full()).ravel()
    lost = v @ (bias - undamped.elastic_forces(q, v, np.zeros(model.n), u).full().ravel())

    def energy(t: float) -> float:
        moved = np.concatenate([joints + t * w + t * t / 2 * alpha, w + t * alpha, alpha])
        return float(np.sum(model.energy(q + t * v + t * t / 2 * a, v + t * a, moved).full()))

    h = 1e-7
    rate = (8 * (energy(h) - energy(-h)) - (energy(2 * h) - energy(-2 * h))) / (12 * h)
    assert rate == pytest.approx(torque @ w - lost, rel=1e-5, abs=1e-4)


def test_a_load_that_buckles_the_robot_is_an_error_with_the_pose(heavy: Scene) -> None:
    """No silent NaN where there is no stable equilibrium."""
    scene = heavy.replace({"payload.mass": 60.0, "mechanism.material.youngs_modulus": 7e7})
    with pytest.raises(EquilibriumError, match=r"q11 = .* rad"):
        natural_frequencies(scene, motor_angles(scene.mechanism, (-0.175, 0.32)))


Array = np.ndarray
LINKS = ("link11", "link12", "link21", "link22")
GRAVITY, PAYLOAD, INERTIA, MOTOR, SPRING = np.array([2.0, -9.0]), 1.7, 0.03, 0.02, 800.0
IMAGINARY = 1e-40j
"""A small imaginary time, whose part of a place is the velocity without cancellation."""

BENDING = {
    "mechanism.proximal": {"length": 0.3, "diameter": 0.05, "inner_diameter": 0.03},
    "mechanism.distal": {"length": 0.4, "diameter": 0.03, "inner_diameter": 0.01},
    "payload": {"mass": PAYLOAD, "inertia": INERTIA},
    "effects.gravity": GRAVITY.tolist(),
    "effects.damping": {"kind": "none"},
    "effects.motor_inertia": MOTOR,
    "effects.transmission": {"stiffness": SPRING},
    "effects.proximal_bending": 2,
    "effects.distal_bending": 2,
    "effects.proximal_axial": 1,
    "effects.distal_axial": 1,
    "effects.foreshortening": True,
}
NODES, WEIGHTS = (each / 2.0 for each in np.polynomial.legendre.leggauss(30))
PLACES = NODES + 0.5
"""Normalised places along a link, and their weights."""


def shapes_at(scene: Scene, group: str, kind: str) -> list[Callable[[str, Array], Array]]:
    """Functions (field, xi) of the shapes of bending or stretching."""
    found = scene_shapes(scene)[group, kind]  # type: ignore[index]
    return [lambda field, xi, each=each: getattr(each, field)(xi) for each in found]  # type: ignore[misc]


def link_energy(
    scene: Scene, group: str, frame: Callable[[complex], tuple[Array, Array, complex]], q: Array, v: Array
) -> Array:
    """Kinetic and potential energy [J] of a link whose frame is (base point, direction, angle) of time, at time 0.

    q and v have the axial coordinate first, then those of bending. The links' axes keep their length when they bend: what is at
    the distance x along the axis has come nearer to the base by half of the integral of the squared slope, or by exactly what the
    cosine of the axis' angle is less than one.
    """
    exact = scene.effects.foreshortening == "exact"
    link, material = getattr(scene.mechanism, group), scene.mechanism.material
    area = np.pi / 4.0 * (link.diameter**2 - link.inner_diameter**2)
    second = np.pi / 64.0 * (link.diameter**4 - link.inner_diameter**4)
    length, young, nu = link.length, material.youngs_modulus, material.poissons_ratio
    (axial,), bending = shapes_at(scene, group, "axial"), shapes_at(scene, group, "bending")

    def bent(field: str, xi: Array, by: Array) -> Array:
        return sum(each * shape(field, xi) for each, shape in zip(by, bending, strict=True))

    def places(time: complex) -> Array:
        """Places (2, points) of the axis."""
        now = q + time * v
        base, along, _ = frame(time)
        slopes = [bent("slope", xi * PLACES, now[1:]) / length for xi in PLACES]
        lost = [1.0 - np.sqrt(1.0 - each**2) if exact else 0.5 * each**2 for each in slopes]
        inner = length * np.array([xi * WEIGHTS @ each for xi, each in zip(PLACES, lost, strict=True)])
        x = PLACES * length + now[0] * axial("value", PLACES) - inner
        across = np.array([-along[1], along[0]])
        return base[:, None] + np.outer(along, x) + np.outer(across, bent("value", PLACES, now[1:]))

    at, mass = places(IMAGINARY), material.density * area * length
    velocity = at.imag / IMAGINARY.imag
    kinetic = 0.5 * mass * WEIGHTS @ (velocity**2).sum(axis=0)
    potential = -mass * GRAVITY @ at.real @ WEIGHTS
    potential += 0.5 * young * area / length * q[0] ** 2 * WEIGHTS @ axial("strain", PLACES) ** 2
    stretch = 1.0 + q[0] * axial("strain", PLACES) / length
    cosine = np.sqrt(1.0 - (bent("rotation", PLACES, q[1:]) / length) ** 2) if exact else np.ones_like(PLACES)
    turned = cosine * stretch if exact else cosine
    potential += 0.5 * young * second / length**3 * WEIGHTS @ (bent("strain", PLACES, q[1:]) / turned) ** 2
    if scene.effects.beam == "timoshenko":
        turning = frame(IMAGINARY)[2].imag / IMAGINARY.imag + bent("rotation", PLACES, v[1:]) / length / cosine
        kinetic += 0.5 * material.density * second * length * WEIGHTS @ turning**2
        # Cowper (1966), with the ratio m of the diameters
        m = link.inner_diameter / link.diameter
        k = 6 * (1 + nu) * (1 + m**2) ** 2 / ((7 + 6 * nu) * (1 + m**2) ** 2 + (20 + 12 * nu) * m**2)
        angle = (bent("slope", PLACES, q[1:]) - bent("rotation", PLACES, q[1:])) / length / turned
        potential += 0.5 * k * young / (2.0 * (1.0 + nu)) * area * length * WEIGHTS @ angle**2
    return np.array([kinetic, potential])


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"effects.basis": "craig-bampton", "effects.beam": "timoshenko"},
        {"effects.basis": "craig-bampton", "effects.beam": "timoshenko", "effects.foreshortening": "exact"},
    ],
    ids=["thin beams, assumed modes", "thick beams, static shapes", "thick beams, bent by a tenth of their length"],
)
def test_energies_are_those_of_the_material_points(changes: dict[str, object], monkeypatch: pytest.MonkeyPatch) -> None:
    """All terms up to the second order in deflections and their rates, at a drawn motion of frames, base points and end effector:
    each link moves, turns, stretches, bends and shortens; payload, motors and transmissions are there too. Exact bending has the
    terms of all orders, with enough nodes."""
    monkeypatch.setattr(link_effects, "SPARE_NODES", 20)
    monkeypatch.setattr(link_effects, "SHIFTS", 22)
    scene = load_scene("barnard2012-6kg").replace(BENDING | changes)
    five_bar, rng = assemble(scene), np.random.default_rng(3)
    derived = five_bar.registry.derived_at_start()
    angle, rate = (dict(zip(LINKS, rng.normal(size=4) * size, strict=True)) for size in (1.0, 4.0))
    points, point_rates = rng.normal(size=(3, 2)) * 0.3, rng.normal(size=(3, 2)) * 2.0
    size = five_bar.robot.q_e.numel()
    q, v = rng.normal(size=size) * 0.02, rng.normal(size=size) * 0.5

    def model(scale: float) -> Array:
        order = ("link11", "link21", "link12", "link22")
        directions = [f(angle[name]) for name in order for f in (np.cos, np.sin)]
        x = [*directions, *points.ravel(), *(scale * q)]
        rates = [*(rate[name] for name in order), *point_rates.ravel(), *(scale * v)]
        return five_bar.dynamics.energy(x, rates, derived).full().ravel()

    def exact(scale: float) -> Array:
        moved, moving = scale * q, scale * v
        half = scene.mechanism.base_half_distance
        fixed = {"link11": np.array([-half, 0.0]), "link21": np.array([half, 0.0])}
        ends = np.cumsum([0] + [3] * 4)
        total = np.zeros(2)
        for name, (first, last) in zip(LINKS, pairwise(ends), strict=True):
            leg = int(name[4]) - 1

            def frame(time: complex, name: str = name, leg: int = leg) -> tuple[Array, Array, complex]:
                turned = angle[name] + time * rate[name]
                base = fixed.get(name, points[leg] + time * point_rates[leg])
                return base, np.array([np.cos(turned), np.sin(turned)]), turned

            group = "proximal" if name.endswith("1") else "distal"
            total += link_energy(scene, group, frame, moved[first:last], moving[first:last])
        # payload, which turns with the last section of link 12, motors behind their transmissions
        tips = [float(each("rotation", np.ones(1))[0]) for each in shapes_at(scene, "distal", "bending")]
        sine, bending = (tips @ each[4:6] / scene.mechanism.distal.length for each in (moved, moving))
        is_exact = scene.effects.foreshortening == "exact"
        section = rate["link12"] + (bending / np.sqrt(1.0 - sine**2) if is_exact else bending)
        motors = np.array([rate["link11"], rate["link21"]]) - moving[-2:]
        total[0] += 0.5 * (PAYLOAD * point_rates[2] @ point_rates[2] + INERTIA * section**2 + MOTOR * motors @ motors)
        total[1] += 0.5 * SPRING * moved[-2:] @ moved[-2:] - PAYLOAD * GRAVITY @ points[2]
        return total

    if scene.effects.foreshortening == "exact":
        for scale in (-1.0, 1.0):
            np.testing.assert_allclose(model(scale), exact(scale), rtol=1e-8)
        return
    scales = np.linspace(-1.0, 1.0, 5)
    model_terms, exact_terms = (
        np.linalg.solve(np.vander(scales), [f(each) for each in scales]) for f in (model, exact)
    )
    np.testing.assert_allclose(model_terms[:2], 0.0, atol=1e-9 * np.abs(model_terms).max())
    for order in (2, 3, 4):
        np.testing.assert_allclose(
            model_terms[order], exact_terms[order], rtol=1e-9, atol=1e-11 * np.abs(model_terms[4]).max()
        )


POSE = (-0.1, 0.3)
FAMILIES = ("distal_axial", "proximal_axial", "proximal_bending")
VARIANTS = {
    "the paper's": {"effects.proximal_axial": 2},
    "static shapes": {"effects.basis": "craig-bampton", "effects.proximal_axial": 1},
    "thick": {"effects.beam": "timoshenko", "effects.proximal_axial": 1},
}


@pytest.fixture(params=VARIANTS.values(), ids=VARIANTS.keys())
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene("barnard2012-6kg").replace(request.param)


def without(scene: Scene, family: str) -> Scene:
    return scene.replace({f"effects.{family}": 0})


def statically(scene: Scene, *families: str) -> Scene:
    return scene.replace({"effects.quasi_static": list(families)})


@pytest.mark.parametrize(("variant", "family"), list(zip(VARIANTS, FAMILIES, strict=True)))
def test_the_dynamics_are_those_without_the_family(variant: str, family: str) -> None:
    """No state and not one operation more in the equations of motion, whichever the family and its shapes."""
    scene = load_scene("barnard2012-6kg").replace(VARIANTS[variant])
    left_out, static = build_model(without(scene, family)), build_model(statically(scene, family))
    assert static.unknowns == left_out.unknowns
    for function in ("residual", "mass_matrix"):
        assert static.functions[function].n_instructions() == left_out.functions[function].n_instructions()
    joints = motor_angles(scene.mechanism, POSE)
    np.testing.assert_allclose(
        natural_frequencies(statically(scene, family), joints),
        natural_frequencies(without(scene, family), joints),
        rtol=1e-12,
    )


def test_under_the_loads_of_a_motion_the_robot_deflects_as_its_springs_do(scene: Scene) -> None:
    """Without any state the end effector is where the full model's springs balance inertia, to second order."""
    joints = np.array(motor_angles(scene.mechanism, POSE))
    u = np.concatenate([joints, [2.0, -3.0], [150.0, -80.0]])
    full, static = numeric_model(scene), numeric_model(statically(scene, *FAMILIES))
    zeros = np.zeros(full.n)
    balance = root(lambda q: full.elastic_forces(q, zeros, zeros, u).full().ravel(), zeros, tol=1e-14).x
    expected = full.motion(balance, zeros, zeros, u)[0].full().ravel()
    rigid = full.motion(zeros, zeros, zeros, u)[0].full().ravel()
    assert static.n == 0
    found = static.motion([], [], [], u)[0].full().ravel()
    assert np.hypot(*(found - expected)) < 5e-3 * np.hypot(*(expected - rigid))


def test_forces_at_the_end_effector_deflect_it_too(scene: Scene) -> None:
    """The torque-driven plant yields to a pull by the compliance of its static families, J K^-1 J'."""
    scene = scene.replace({"effects.gravity": [0.0, 0.0], "effects.proximal_bending": 0, "effects.proximal_axial": 0})
    plant = build_model(statically(scene.replace({"cosimulation.drive": "torque"}), "distal_axial"))
    names = [variable.name for variable in plant.outputs]
    derived = plant.functions["derive"]([variable.start or 0.0 for variable in plant.parameters])
    joints, rest = np.array(motor_angles(scene.mechanism, POSE)), np.zeros(2)

    def position(force: float) -> np.ndarray:
        values = plant.functions["outputs"](joints, rest, rest, [0.0, 0.0, 0.0, force], derived).full().ravel()
        return np.array([values[names.index(f"end_effector.position.{axis}")] for axis in "xy"])

    model, u = numeric_model(scene), standstill(joints)
    zeros, step = np.zeros(model.n), 1e-5
    tips = [[model.motion(sign * step * e, zeros, zeros, u)[0].full() for sign in (1, -1)] for e in np.eye(model.n)]
    by_q = np.hstack([(ahead - behind) / (2 * step) for ahead, behind in tips])
    expected = by_q @ np.linalg.solve(model.static_stiffness(zeros, u).full(), by_q[1])
    np.testing.assert_allclose((position(1e3) - position(-1e3)) / 2e3, expected, rtol=1e-6)


def test_all_operations_are_those_of_casadi(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = casadi.SX.sym("x", 2), casadi.SX.sym("y")
    a, b = x[0], x[1]
    results = [
        casadi.vertcat(a + b, a - b, a * b, a / b, -a, a**2, casadi.sqrt(b), 1 / b, 2 * a, y),
        casadi.vertcat(casadi.sin(a), casadi.cos(a), casadi.tan(a), casadi.exp(a), casadi.log(b), casadi.tanh(a)),
        casadi.vertcat(casadi.atan(a), casadi.asin(a / 9), casadi.acos(a / 9), casadi.atan2(a, b), b**y, b**2.5),
        casadi.vertcat(casadi.fabs(a), casadi.sign(a), casadi.fmin(a, b), casadi.fmax(a, b), casadi.sinh(a), 3.0),
        casadi.vertcat(casadi.if_else(casadi.logic_and(a < b, a != y), a, b), casadi.cosh(a), a <= b, a == b, a > 0),
    ]  # fmt: skip
    function = casadi.Function("f", [x, y], [casadi.densify(casadi.vertcat(*results)), a * b])
    random = np.random.default_rng(0)
    points = np.column_stack([random.uniform(-2.0, 2.0, 50), random.uniform(0.1, 3.0, 50)])
    others = random.uniform(-1.0, 1.0, (50, 1))
    # in parts of 16 points too
    for size in (1000, 16):
        monkeypatch.setattr(vectorised, "CHUNK", size)
        found = Vectorised(function)([points, others])
        expected = function.map(50)(points.T, others.T)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, np.asarray(other).T, rtol=1e-15, atol=1e-15)
    for one, other in zip(CompiledAtPoints(function)([points, others]), found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14, atol=1e-15)


def test_other_operations_are_refused() -> None:
    x = casadi.SX.sym("x")
    with pytest.raises(NotImplementedError, match="f: CasADi's operation"):
        Vectorised(casadi.Function("f", [x], [casadi.erf(x)]))
