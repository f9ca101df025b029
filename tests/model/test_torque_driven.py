"""The direct model: against the inverse one, the closed forms of its drive effects, and its own linearisation."""

from __future__ import annotations

from collections.abc import Callable

import casadi
import numpy as np
import pytest

from flexfmu.model.linear import linearize, operating_point
from flexfmu.model.multipliers import constrained_model, motion_driven_accelerations
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.plants import build_model
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicModel

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


DRIVES = {
    "links only": {},
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
    "reactions asked for": {"effects.reactions": True},
}


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
    multipliers = motion_driven_accelerations(constrained, q, v, a_a).reactions
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
