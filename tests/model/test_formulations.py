"""The minimal formulation against the one with multipliers, which shares its energies but no assembly and no projection."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.model.multipliers import constrained_model, motion_driven_accelerations
from flexfmu.model.numeric import numeric_model
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

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


def test_both_formulations_have_the_same_accelerations_and_torques(scene: Scene) -> None:
    """Index reduction by closed-form assembly neither loses nor adds a force: accelerations to 1e-10, torques to 1e-9."""
    constrained = constrained_model(scene)
    for q_a, v_a, a_a, q_e, v_e in random_states(scene):
        a_e, (position, velocity, acceleration, torque) = minimal_solution(scene, q_a, v_a, a_a, q_e, v_e)
        q, v = (np.asarray(part.full()).ravel() for part in constrained.assembled(q_a, q_e, v_a, v_e))
        full = motion_driven_accelerations(constrained, q, v, a_a)
        # the closed form solves the paper's eq. (18) and its time derivative to rounding
        assert np.abs(constrained.constraints(q).full()).max() <= 1e-15
        assert np.abs(constrained.jacobian(q).full() @ v).max() <= 1e-13
        scale = max(1.0, np.abs(a_e).max(initial=0.0))
        assert np.abs(full.accelerations[2 : 2 + len(q_e)] - a_e).max(initial=0.0) <= 1e-10 * scale
        np.testing.assert_allclose(full.accelerations[-2:], acceleration, atol=1e-10 * scale)
        # the torques of elastic transmissions are differences of forces that belong to the largest accelerations
        rounding = (
            1e-13 * np.abs(full.accelerations).max() if scene.effects.transmission else 1e-9 * np.abs(torque).max()
        )
        np.testing.assert_allclose(full.torque, torque, rtol=1e-9, atol=rounding)
        np.testing.assert_allclose(q[-2:], position, atol=1e-15)
        np.testing.assert_allclose(v[-2:], velocity, atol=1e-12)


def test_constraint_violations_decay_as_baumgarte_says(scene: Scene) -> None:
    """Off the constraint manifold the multipliers force f'' + 2 a f' + a² f = 0, which damps drift critically."""
    constrained, rate = constrained_model(scene), 100.0
    q_a, v_a, a_a, q_e, v_e = random_states(scene, 1)[0]
    q, v = (np.asarray(part.full()).ravel() for part in constrained.assembled(q_a, q_e, v_a, v_e))
    q[-2:] += 1e-5
    motion = motion_driven_accelerations(constrained, q, v, a_a, baumgarte=rate)
    psi, f = constrained.jacobian(q).full(), constrained.constraints(q).full().ravel()
    second = psi @ motion.accelerations + constrained.curvature(q, v).full().ravel()
    np.testing.assert_allclose(
        second, -2 * rate * psi @ v - rate**2 * f, atol=1e-9 * np.abs(motion.accelerations).max()
    )
