"""Statics, modes, energy and scaling of the assembled robot."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.model.numeric import numeric_model, standstill
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies, static_equilibrium

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
