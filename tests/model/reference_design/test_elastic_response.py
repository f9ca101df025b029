"""Joint splines, and the elastic response to them against the FMU and differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import flexfmu
from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.collocation import collocation
from flexfmu.model.reference_design.elastic_response import ElasticResponse, RobotVariant, VariantModel
from flexfmu.model.reference_design.joint_spline import (
    DEGREE,
    REST,
    JointSpline,
    basis,
    derivative_matrix,
    fitted,
    rest_matrix,
)
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies, static_equilibrium
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import PiecewisePolynomial

FINE = np.linspace(0.0, 1.0, 2001)


def _random(intervals: int, duration: float = 0.3, crowding: float = 0.0) -> JointSpline:
    free = np.random.default_rng(intervals).normal(size=(intervals + DEGREE - 2 * REST + 2, 2))
    return JointSpline(rest_matrix(intervals + DEGREE) @ free, duration, crowding)


@pytest.mark.parametrize("crowding", [0.0, 0.4, 0.7])
def test_the_trajectory_is_the_spline(crowding: float) -> None:
    """Angles and derivatives up to jerk, and rest at both ends."""
    spline = _random(9, crowding=crowding)
    exact, motion = spline.evaluate(FINE, 3), spline.trajectory()
    assert isinstance(motion, PiecewisePolynomial)
    assert (motion.coordinates, motion.degree, len(motion.knots)) == ("joints", DEGREE, 10)
    inside = slice(1, -1)
    found = motion.evaluate(FINE * spline.duration, 3)
    scale = abs(exact).max(axis=(1, 2))[:, np.newaxis, np.newaxis]
    assert abs((found - exact) / scale)[:, inside].max() < 1e-11
    assert abs(exact[1:, [0, -1]] / scale[1:]).max() < 1e-12


@pytest.mark.parametrize("order", [1, 2, 3])
def test_coefficients_bound_derivatives(order: int) -> None:
    """No value is larger than the largest coefficient, and the bound is close on smooth motions."""
    spline = _random(12)
    bounds = derivative_matrix(spline.intervals, order) @ spline.coefficients / spline.duration**order
    assert abs(spline.evaluate(FINE, 3)[order]).max() <= abs(bounds).max() * (1 + 1e-12)
    points = np.linspace(0.1, 0.9, 7)
    slope = (basis(12, points + 1e-6, order - 1) - basis(12, points - 1e-6, order - 1)) / 2e-6
    assert basis(12, points, order) == pytest.approx(slope, abs=1e-4 * abs(slope).max())
    assert derivative_matrix(12, order) @ np.ones(17) == pytest.approx(0.0, abs=1e-9)


def test_the_fit_keeps_splines_and_ends() -> None:
    """A spline is found again; another motion keeps its ends to rounding."""
    spline = _random(8, crowding=0.5)
    again = fitted(spline.trajectory(), 8, crowding=0.5)
    assert again.coefficients == pytest.approx(spline.coefficients, abs=1e-10)
    coarse = fitted(_random(6).trajectory(), 20)
    assert coarse.evaluate([0.0, 1.0], 0)[0] == pytest.approx(_random(6).evaluate([0.0, 1.0], 0)[0], abs=1e-14)
    assert abs(coarse.evaluate(FINE, 0) - _random(6).evaluate(FINE, 0)).max() < 1e-3


def test_wrong_shapes_are_errors() -> None:
    """Too few coefficients for rest at both ends, and one joint."""
    with pytest.raises(TrajectoryError, match="8 or more"):
        JointSpline(np.zeros((7, 2)), 0.3)
    with pytest.raises(TrajectoryError, match="2"):
        JointSpline(np.zeros((20, 1)), 0.3)


VARIANTS = ({"payload.mass": 4.2}, {"payload.mass": 7.8, "material.youngs_modulus": 63e9, "damping.ratio": 0.01})


@pytest.fixture(scope="module")
def scene() -> Scene:
    changes = {"effects.proximal_bending": 1, "effects.distal_axial": 1, "trajectory.dwell": 0.05}
    return load_scene("barnard2012-6kg").replace(changes)


@pytest.fixture(scope="module")
def motion(scene: Scene) -> JointSpline:
    return fitted(plan(scene).joints, 20).with_duration(0.3)


def response_of(scene: Scene, motion: JointSpline, steps: int = 60) -> ElasticResponse:
    return ElasticResponse([RobotVariant(scene, each) for each in VARIANTS], motion.coefficients[0], steps)


def changed(motion: JointSpline, change: RealArray) -> JointSpline:
    coefficients = motion.coefficients.copy()
    coefficients[REST:-REST] += change[:-1].reshape(2, -1).T
    return JointSpline(coefficients, motion.duration + change[-1])


def test_the_tableaus_are_those_of_the_book() -> None:
    """Radau IIA of order 5, whose last stage's weights are those of the step, and Gauss of order 6."""
    root, method = 6**0.5, collocation("radau", 3)
    assert method.nodes == pytest.approx([(4 - root) / 10, (4 + root) / 10, 1.0], rel=1e-15)
    assert method.matrix[-1] == pytest.approx([(16 - root) / 36, (16 + root) / 36, 1 / 9], rel=4e-15)
    assert method.whole == pytest.approx(method.matrix[-1], rel=4e-15)
    for power in range(3):
        integrals = method.nodes ** (power + 1) / (power + 1)
        np.testing.assert_allclose(method.matrix @ method.nodes**power, integrals, atol=1e-15)
    gauss = collocation("legendre", 3)
    assert gauss.matrix[0] == pytest.approx([5 / 36, 2 / 9 - 15**0.5 / 15, 5 / 36 - 15**0.5 / 30], rel=4e-15)
    assert gauss.whole == pytest.approx([5 / 18, 4 / 9, 5 / 18], rel=4e-15)
    assert gauss.whole_twice @ gauss.nodes**2 == pytest.approx(1 / 12, rel=4e-15)


def test_the_response_is_that_of_the_fmu(motion: JointSpline) -> None:
    shipped = load_scene("barnard2012-6kg")
    elastic = response_of(shipped, motion, 200)
    found = elastic.of_motion(motion, derivatives=False)
    for variant, values in enumerate(VARIANTS):
        run = flexfmu.run(shipped, trajectory=motion.trajectory(), tolerance=1e-8, parameters=values)
        time, of_time = np.unique(run.recording.time, return_index=True)
        stages = elastic.fractions * motion.duration
        for axis, name in enumerate("xy"):
            signal = run.recording[f"end_effector.position.{name}"].values
            interpolated = CubicSpline(time, signal[of_time])(stages)
            np.testing.assert_allclose(found.position[variant, :, axis], interpolated, atol=2e-8)
            torque = run.recording[f"joint{axis + 1}.torque"].values
            assert abs(found.torque[variant, :, axis]).max() == pytest.approx(abs(torque).max(), rel=2e-3)


def test_derivatives_are_those_of_finite_differences(scene: Scene, motion: JointSpline) -> None:
    elastic = response_of(scene, motion)
    found = elastic.of_motion(motion)
    direction = np.random.default_rng(0).standard_normal(found.end_by.shape[-1]) * 1e-5
    above, below = (elastic.of_motion(changed(motion, sign * direction), derivatives=False) for sign in (1, -1))
    for name in ("position", "torque", "end"):
        difference = (getattr(above, name) - getattr(below, name)) / 2
        exact = getattr(found, f"{name}_by") @ direction
        np.testing.assert_allclose(difference, exact, rtol=1e-5, atol=1e-5 * abs(exact).max())


def test_a_response_does_not_depend_on_the_motions_before_it(scene: Scene, motion: JointSpline) -> None:
    """Neither on another motion nor on one that has no solution."""
    elastic = response_of(scene, motion)
    elastic.of_motion(motion.with_duration(0.5))
    with pytest.raises(EquilibriumError, match="has no solution"):
        elastic.of_motion(motion.with_duration(0.004))
    after = elastic.of_motion(motion)
    np.testing.assert_allclose(after.end, response_of(scene, motion).of_motion(motion).end, atol=1e-9)


def test_variants_at_rest_have_the_equilibria_and_the_frequencies_of_their_scenes(
    scene: Scene, motion: JointSpline
) -> None:
    joints = motion.coefficients[-1]
    rest = response_of(scene, motion).models[0].rest(joints)
    frequencies, _ = rest.modes
    heavy = scene.replace({"payload.mass": 7.8, "mechanism.material.youngs_modulus": 63e9})
    for variant, of_scene in enumerate((scene.replace({"payload.mass": 4.2}), heavy)):
        equilibrium = static_equilibrium(of_scene, joints)
        np.testing.assert_allclose(rest.elastic[variant], equilibrium.elastic, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(rest.torque[variant], equilibrium.torque, rtol=1e-9)
        np.testing.assert_allclose(frequencies[variant] / (2 * np.pi), natural_frequencies(of_scene, joints), rtol=1e-9)


def test_an_unknown_parameter_is_named(scene: Scene, motion: JointSpline) -> None:
    with pytest.raises(SceneError, match=r"has no parameter `payload\.weight`"):
        ElasticResponse([RobotVariant(scene, {"payload.weight": 1.0})], motion.coefficients[0], 10)


def test_no_force_in_a_joint_has_a_derivative() -> None:
    """Without payload and gravity nothing pulls at rest, where the magnitude of a force has no derivative of its own."""
    scene = load_scene("barnard2012-6kg").replace({"payload.mass": 0.0, "effects.gravity": [0.0, 0.0]})
    model = VariantModel([RobotVariant(scene)], ("reaction",))
    angles = plan(scene).once.joints.evaluate([0.0], 0, "right")[0]
    still = [np.zeros((1, 1, model.n))] * 3
    values, derivatives = model.linearised(*still, np.hstack([angles, np.zeros((1, 4))]))
    assert abs(values[..., -4:]).max() < 1e-5
    assert np.isfinite(derivatives).all()
