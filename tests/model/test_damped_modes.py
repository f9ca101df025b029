"""Frequencies and damping ratios of the assembled robot, which shapers are designed from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.numeric import numeric_model, standstill
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import damped_modes, natural_frequencies, static_equilibrium


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The paper's robot with 6 kg."""
    return load_scene("barnard2012-6kg")


@pytest.fixture(scope="module")
def end_joints(scene: Scene) -> np.ndarray:
    """Motor angles at the end of its path."""
    motion = plan(scene)
    return np.asarray(motion.joints.evaluate(motion.duration, 0)[0, 0])


def test_without_damping_they_are_the_natural_frequencies(scene: Scene, end_joints: np.ndarray) -> None:
    """No damping: ratios are zero to rounding, frequencies those of the undamped problem."""
    undamped = scene.replace({"effects.damping": {"kind": "none"}})
    modes = damped_modes(undamped, end_joints)
    np.testing.assert_allclose(modes.frequencies, natural_frequencies(undamped, end_joints), rtol=1e-10)
    np.testing.assert_allclose(modes.ratios, 0.0, atol=1e-12)


@pytest.mark.slow
def test_the_free_vibration_decays_as_the_first_mode_says(scene: Scene, end_joints: np.ndarray) -> None:
    """A free vibration of the nonlinear model from its first mode shape, integrated by SciPy, has that frequency and decay."""
    model, u = numeric_model(scene), standstill(end_joints)
    modes, rest = damped_modes(scene, end_joints), static_equilibrium(scene, end_joints).elastic
    stiffness, mass = model.static_stiffness(rest, u).full(), model.mass_matrix(rest, u).full()
    values, vectors = np.linalg.eig(np.linalg.solve(mass, stiffness))
    shape = np.real(vectors[:, np.argmin(values.real)])
    shape = 1e-6 * shape / np.max(np.abs(shape))

    def rates(time: float, state: np.ndarray) -> np.ndarray:
        q, v = np.split(state, 2)
        bias = model.elastic_forces(q, v, np.zeros(model.n), u).full().ravel()
        return np.concatenate([v, np.linalg.solve(model.mass_matrix(q, u).full(), -bias)])

    period = 1.0 / (modes.frequencies[0] * np.sqrt(1.0 - modes.ratios[0] ** 2))
    start = np.concatenate([rest + shape, np.zeros(model.n)])
    found = solve_ivp(rates, (0.0, 3.0 * period), start, method="Radau", rtol=1e-8, atol=1e-13)
    left = np.dot(found.y[: model.n, -1] - rest, mass @ shape) / np.dot(shape, mass @ shape)
    decay = np.exp(-2.0 * np.pi * 3.0 * modes.ratios[0] / np.sqrt(1.0 - modes.ratios[0] ** 2))
    assert left == pytest.approx(decay, rel=5e-3)


def test_overdamped_motions_are_left_out(scene: Scene, end_joints: np.ndarray) -> None:
    """With much damping the high modes creep instead of vibrating; the rest keeps ratios below 1, ascending frequencies."""
    heavy = scene.replace({"effects.damping": {"kind": "stiffness", "time": 1e-3}})
    modes = damped_modes(heavy, end_joints)
    assert 0 < len(modes.frequencies) < numeric_model(heavy).n
    assert np.all(modes.ratios < 1.0)
    assert np.all(np.diff(modes.frequencies) > 0.0)


def test_a_rigid_robot_has_no_modes(scene: Scene, end_joints: np.ndarray) -> None:
    """Without elastic links nothing vibrates."""
    rigid = scene.replace({"effects.proximal_bending": 0, "effects.distal_axial": 0})
    assert damped_modes(rigid, end_joints).frequencies.size == 0
