"""The motion-driven plant's functions: exact time derivatives, direct feedthrough, scales and start values."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.model.plants import build_model
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import FUNCTION_SIGNATURES, SymbolicModel


@pytest.fixture(scope="module")
def plant() -> SymbolicModel:
    return build_model(load_scene("barnard2012-6kg"))


@pytest.fixture(scope="module")
def derived(plant: SymbolicModel) -> np.ndarray:
    return plant.functions["derive"]([variable.start for variable in plant.parameters]).full().ravel()


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


def test_first_rates_are_the_directional_derivatives_along_the_motion(
    plant: SymbolicModel, derived: np.ndarray
) -> None:
    """Taylor coefficients and forward differentiation are two ways to the same derivatives."""
    motion = PolynomialMotion(plant.degrees_of_freedom)
    rates, changes = (evaluate(plant, name, motion, 0.01, derived) for name in ("motion_rate1", "motion_forward"))
    np.testing.assert_allclose(rates, changes, rtol=1e-9, atol=1e-12 * np.abs(changes).max())


@pytest.mark.parametrize("order", [1, 2])
def test_rates_are_the_time_derivatives_of_the_functions(plant: SymbolicModel, derived: np.ndarray, order: int) -> None:
    """First and second rates agree with eighth-order differences along a motion with known derivatives."""
    motion, n = PolynomialMotion(plant.degrees_of_freedom), plant.degrees_of_freedom
    h, weights = 2e-4, np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    samples = np.array([along(plant, motion, k * h, derived, order - 1) for k in range(-4, 5)])
    difference, exact = weights @ samples / h, along(plant, motion, 0.0, derived, order)
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


def test_singularity_measure_is_the_sine_between_the_distal_links(plant: SymbolicModel, derived: np.ndarray) -> None:
    """Undeformed, the measure is the rigid robot's; positive on the scene's assembly side."""
    from flexfmu.model.kinematics import RigidKinematics

    scene = load_scene("barnard2012-6kg")
    u = np.array([*motor_angles(scene.mechanism, (0.05, 0.3)), 0, 0, 0, 0])
    measure = float(plant.functions["singularity"](np.zeros(12), u, derived))
    assert measure == pytest.approx(float(RigidKinematics(scene.mechanism).sine(np.array([[0.05, 0.3]]))[0]), rel=1e-12)
    assert measure > plant.minimum_margin
