"""Shaped motions: exact sums of shifted motions, on joint references and along the path."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.experiment.planning import MotionPlan, plan, shape_joints, shape_path
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.joint import EndEffectorTrajectory
from flexfmu.trajectories.profiles import evaluate_profile
from flexfmu.trajectories.shapers.designs import SHAPERS, design
from flexfmu.trajectories.shapers.sequence import (
    Oscillator,
    ShapedTrajectory,
    path_deviation,
    shape_along_path,
)

MODE = Oscillator(57.3, 0.08)
PROFILES = [{"kind": "poly7"}, {"kind": "bang-bang"}, {"kind": "trapezoidal", "ramp": 0.25}, {"kind": "cycloidal"}]


@pytest.fixture(scope="module", params=PROFILES, ids=lambda profile: profile["kind"])
def motion(request: pytest.FixtureRequest) -> MotionPlan:
    """The paper's motion with each profile."""
    return plan(load_scene("barnard2012-6kg").replace({"trajectory.profile": request.param}))


@pytest.mark.parametrize("name", sorted(SHAPERS))
def test_shaped_joints_are_the_direct_sum(motion: MotionPlan, name: str) -> None:
    """Value and six derivatives are Σ A_i q(t - T_i) to rounding, at any time and before and after the motion."""
    sequence = design(name, [MODE])
    shaped = ShapedTrajectory(motion.joints, sequence)
    time = np.random.default_rng(3).uniform(-0.1, shaped.duration + 0.1, 200)
    direct = sum(
        amplitude * motion.joints.evaluate(time - delay, 6)
        for delay, amplitude in zip(sequence.times, sequence.amplitudes, strict=True)
    )
    scale = np.max(np.abs(direct), axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(shaped.evaluate(time, 6) / scale, direct / scale, atol=1e-12)


def test_one_sided_limits_at_shifted_breakpoints(motion: MotionPlan) -> None:
    """At every breakpoint both limits are those of the motion beside it; between breakpoints nothing jumps."""
    shaped = ShapedTrajectory(motion.joints, design("ei", [MODE]))
    points = np.array(shaped.breakpoints)
    assert points[0] == 0.0
    assert points[-1] == shaped.duration
    near = 1e-9
    left, right = shaped.evaluate(points, 2, "left"), shaped.evaluate(points, 2, "right")
    rate = np.max(np.abs(shaped.evaluate(np.linspace(0.0, shaped.duration, 999), 3)[3]))
    np.testing.assert_allclose(left[2], shaped.evaluate(points - near, 2)[2], atol=2.0 * near * rate + 1e-9)
    np.testing.assert_allclose(right[2], shaped.evaluate(points + near, 2)[2], atol=2.0 * near * rate + 1e-9)


@pytest.mark.parametrize("name", ["zv", "mzv", "zvdd", "3-hump-ei"])
def test_shaping_along_the_path_keeps_the_path(motion: MotionPlan, name: str) -> None:
    """The end effector stays on the geometric path to rounding, and takes longer by the sequence's duration."""
    sequence = design(name, [MODE])
    shaped = shape_along_path(motion.profiled, sequence)
    assert path_deviation(shaped, motion.profiled.path) < 1e-15
    assert shaped.duration == motion.duration + sequence.duration
    np.testing.assert_allclose(shaped.evaluate(shaped.duration, 0)[0, 0], motion.profiled.path.end, atol=1e-15)


@pytest.mark.parametrize("name", ["um-zv", "zv", "zvdd", "3-hump-ei"])
def test_shaped_profile_is_the_sum_of_shifted_profiles(motion: MotionPlan, name: str) -> None:
    """s(t) and its time derivatives are Σ A_i s(t - T_i)."""
    sequence = design(name, [MODE])
    profile, duration = motion.profiled.profile, motion.duration
    shaped = shape_along_path(motion.profiled, sequence)
    eta = np.random.default_rng(5).uniform(0.0, 1.0, 300)
    found = evaluate_profile(shaped.profile, eta, 4).rescale(1.0 / shaped.duration).derivatives()
    expected = np.zeros_like(found)
    for delay, amplitude in zip(sequence.times, sequence.amplitudes, strict=True):
        fraction = (eta * shaped.duration - delay) / duration
        inside = (fraction > 0.0) & (fraction < 1.0)
        jet = evaluate_profile(profile, fraction[inside], 4).rescale(1.0 / duration).derivatives()
        expected[:, inside] += amplitude * jet
        expected[0, fraction >= 1.0] += amplitude
    scale = np.max(np.abs(expected), axis=1, keepdims=True) + (np.arange(5) > 4)[:, None] + 1e-300
    scale = np.maximum(scale, duration ** -np.arange(5.0)[:, None])
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-11)


def test_joints_deviate_and_the_path_says_how_far(motion: MotionPlan) -> None:
    """Shaped joints cut the corners by a fraction of the distance travelled in the shaper's duration; unshaped ones don't."""
    kinematics = RigidKinematics(motion.scene.mechanism)
    path = motion.profiled.path
    assert path_deviation(EndEffectorTrajectory(motion.joints, kinematics), path) < 1e-14
    found = [
        path_deviation(EndEffectorTrajectory(ShapedTrajectory(motion.joints, design(name, [MODE])), kinematics), path)
        for name in ("zv", "zvd", "zvdd")
    ]
    assert 1e-4 < found[0] < found[1] < found[2] < 3e-3


def test_forward_kinematics_inverts_the_inverse(motion: MotionPlan) -> None:
    """The end effector of the planned joints moves as planned, derivatives included."""
    kinematics = RigidKinematics(motion.scene.mechanism)
    time = np.linspace(-0.01, motion.duration + 0.01, 301)
    expected = motion.task.evaluate(time, 4)
    found = EndEffectorTrajectory(motion.joints, kinematics).evaluate(time, 4)
    scale = np.max(np.abs(expected), axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-12)


def test_a_motion_along_the_path_does_not_go_backwards(motion: MotionPlan) -> None:
    """Negative impulses are fine while the speed stays positive, and refused with time and remedy where it doesn't."""
    slow = Oscillator(0.5)
    with pytest.raises(TrajectoryError, match=r"go backwards along its path at t = .* s.*shape the joint references"):
        shape_along_path(motion.profiled, design("um-zv", [slow]))


def test_two_shapers_along_the_path_are_both_applied(motion: MotionPlan) -> None:
    """One after the other they are the shaper of both sequences convolved; on shaped joints there is no path to keep."""
    first, second = design("zv", [MODE]), design("zv", [Oscillator(120.0, 0.05)])
    twice = shape_path(shape_path(motion, first), second)
    once = shape_path(motion, first.convolve(second))
    time = np.linspace(0.0, once.duration, 200)
    np.testing.assert_allclose(twice.joints.evaluate(time, 0), once.joints.evaluate(time, 0), atol=1e-12)
    with pytest.raises(TrajectoryError, match="along the path first"):
        shape_path(shape_joints(motion, first), second)
