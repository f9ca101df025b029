"""Motions along paths, of the joints and of shapers: derivatives, breakpoints, margins, deviations from the path."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.experiment.planning import MotionPlan, plan, shape_joints, shape_path
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import Jet, RealArray, arctan2
from flexfmu.trajectories.joint import EndEffectorTrajectory, JointTrajectory, Margin
from flexfmu.trajectories.path import Blend, ClothoidPair, LameBlend, PickAndPlacePath, PolarPolynomial
from flexfmu.trajectories.profiles import Profile, bang_bang, evaluate_profile, seventh_degree_polynomial, trapezoidal
from flexfmu.trajectories.shapers.designs import SHAPERS, design
from flexfmu.trajectories.shapers.sequence import Oscillator, ShapedTrajectory, path_deviation, shape_along_path
from flexfmu.trajectories.trajectory import TaskTrajectory

PROFILES = (seventh_degree_polynomial(), bang_bang(), trapezoidal(0.25), trapezoidal(0.125))
BLENDS = (LameBlend(0.025, 0.025), ClothoidPair(0.025, 0.025), PolarPolynomial(0.025, 0.025), LameBlend(0.02, 0.175))


def planned(
    blend: Blend = BLENDS[0], profile: Profile = PROFILES[0], duration: float = 0.43, height: float = 0.025
) -> TaskTrajectory:
    """The paper's path, higher on request."""
    return TaskTrajectory(PickAndPlacePath((-0.175, 0.320), (0.0, -1.0), height, 0.350, blend), profile, duration)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("blend", BLENDS)
def test_each_derivative_is_the_integral_of_the_next(blend: Blend, profile: Profile) -> None:
    """Protects every derivative to order 8 and both one-sided limits, by quadrature between breakpoints.

    Between the limits at an interval's ends a derivative changes by the integral of the next one.
    """
    trajectory = planned(blend, profile, height=0.03)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for start, end in pairwise(trajectory.breakpoints):
        edges = np.linspace(start, end, 17)
        half = 0.5 * np.diff(edges)
        values = trajectory.evaluate((edges[:-1] + half * (nodes[:, None] + 1.0)).ravel(), 8)
        integrals = np.einsum("n,i,knic->kc", weights, half, values.reshape(9, 40, 16, 2))
        first, last = (trajectory.evaluate(t, 8, s)[:, 0] for t, s in ((start, "right"), (end, "left")))
        scale = np.abs(values).max(axis=(1, 2))[:, None] * (end - start)
        assert np.all(np.abs(last[:-1] - first[:-1] - integrals[1:]) <= 1e-11 * scale[1:] + 1e-15)


def test_speed_along_the_path_is_the_profiles() -> None:
    """Protects exact arc length in time: the norm of the velocity doesn't know the path's shape."""
    times = np.linspace(0.0, 0.43, 1001)
    for blend in BLENDS:
        trajectory = planned(blend)
        eta = times / 0.43
        expected = 140.0 * eta**3 * (1.0 - eta) ** 3 * trajectory.path.length / 0.43
        speed = np.hypot(*trajectory.evaluate(times, 1)[1].T)
        np.testing.assert_allclose(speed, expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("blend", BLENDS)
def test_standstill_before_and_after(blend: Blend, profile: Profile) -> None:
    """Protects both ends: outside the motion nothing moves; at its ends one side moves, the other stands."""
    trajectory = planned(blend, profile)
    rest = trajectory.evaluate([-1.0, -1e-9, 0.43 + 1e-9, 9.0], 6)
    np.testing.assert_array_equal(rest[1:], 0.0)
    np.testing.assert_allclose(rest[0, :2], [[-0.175, 0.320]] * 2, rtol=0, atol=1e-16)
    np.testing.assert_allclose(rest[0, 2:], [[0.175, 0.320]] * 2, rtol=0, atol=1e-16)
    np.testing.assert_array_equal(trajectory.evaluate(0.0, 6, "left")[1:], 0.0)
    np.testing.assert_array_equal(trajectory.evaluate(0.43, 6, "right")[1:], 0.0)
    order = 4 if profile == seventh_degree_polynomial() else 2
    first, last = trajectory.evaluate(0.0, 6, "right")[order, 0], trajectory.evaluate(0.43, 6, "left")[order, 0]
    assert first[1] < -1.0  # off towards -y with the first derivative that isn't zero
    assert last[1] == pytest.approx(first[1], rel=1e-12)  # y(t) is symmetric about the middle


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("blend", BLENDS)
def test_only_breakpoints_have_two_sides(blend: Blend, profile: Profile) -> None:
    """Protects the list of breakpoints: position and velocity have one value there, some derivative has two; between
    breakpoints both sides agree."""
    trajectory = planned(blend, profile, height=0.03)
    points = np.array(trajectory.breakpoints)
    left, right = (trajectory.evaluate(points, 6, side) for side in ("left", "right"))
    np.testing.assert_allclose(left[0], right[0], rtol=0, atol=2e-15)
    np.testing.assert_allclose(left[1], right[1], rtol=0, atol=1e-12)
    scale = np.abs(right).max(axis=1)[:, None]
    assert np.all(np.any(np.abs(left - right) > 1e-9 * scale, axis=(0, 2)))
    elsewhere = points[:-1] + 0.37 * np.diff(points)
    left, right = (trajectory.evaluate(elsewhere, 6, side) for side in ("left", "right"))
    np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("profile", PROFILES)
def test_breakpoints_are_where_knots_are_passed(profile: Profile) -> None:
    """Protects what a master lands on: jumps of the profile and passages of knots, 0 and the duration included; what coincides is one."""
    trajectory = planned(ClothoidPair(0.02, 0.03), profile, 0.3, height=0.05)
    points = np.array(trajectory.breakpoints)
    assert len(points) == 2 + 6 + len(profile.jumps)
    assert np.all(np.diff(points) > 1e-6)
    np.testing.assert_allclose(points + points[::-1], 0.3, rtol=0, atol=1e-15)
    position = trajectory.evaluate(points, 0)[0]
    knots = np.stack([jet.value for jet in trajectory.path.jets(trajectory.path.knots, 0)], axis=-1)
    assert np.linalg.norm(position[:, None] - knots, axis=-1).min(axis=0).max() < 1e-15
    # the bang-bang's jump and the knot between two blends without a straight part meet in the middle
    assert planned(LameBlend(0.025, 0.175), bang_bang()).breakpoints == (0.0, 0.215, 0.43)
    assert len(planned(LameBlend(0.025, 0.175), trapezoidal(0.5 - 1e-14)).breakpoints) == 3


def test_a_time_next_to_a_breakpoint_is_at_it() -> None:
    """Protects integer ticks, whose products round: n · step can miss the breakpoint by an ulp on either side."""
    trajectory = planned(profile=bang_bang(), duration=0.43)
    for time in (np.nextafter(0.215, 0.0), 0.215, np.nextafter(0.215, 1.0)):
        left, right = (trajectory.evaluate(time, 2, side)[2, 0, 0] for side in ("left", "right"))
        assert left > 0.0 > right
    for time in (np.nextafter(0.43, 0.0), np.nextafter(0.43, 1.0)):
        assert trajectory.evaluate(time, 2, "left")[2, 0, 1] < -1.0
        assert trajectory.evaluate(time, 2, "right")[2, 0, 1] == 0.0


def test_shapes_follow_times_and_order() -> None:
    """Protects the contract (order + 1, N, 2), for one number, arrays and none."""
    trajectory = planned()
    assert trajectory.evaluate(0.1).shape == (3, 1, 2)
    assert trajectory.evaluate([0.1, 0.2, 0.5], order=0).shape == (1, 3, 2)
    assert trajectory.evaluate(np.empty(0), 4).shape == (5, 0, 2)
    both = trajectory.evaluate([0.1, 0.3], 6)
    np.testing.assert_allclose(both[:, 1:], trajectory.evaluate(0.3, 6), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(both[:3], trajectory.evaluate([0.1, 0.3], 2))


def test_ten_thousand_points_take_as_many_calls_as_a_hundred(count_calls: Callable[..., int]) -> None:
    """Protects vectorisation: no loop goes over the points."""
    trajectory = planned()
    few, many = (np.linspace(0.0, 0.43, count) for count in (101, 10_001))
    trajectory.evaluate(many, 6)  # from here on all tables are made
    assert count_calls(lambda: trajectory.evaluate(many, 6)) == count_calls(lambda: trajectory.evaluate(few, 6)) > 0


def task(
    start: tuple[float, float] = (-0.175, 0.320), height: float = 0.025, profile: Any = None, width: float = 0.35
) -> TaskTrajectory:
    """The paper's path with a Lamé blend, elsewhere on request."""
    path = PickAndPlacePath(start, (0.0, -1.0), height, width, LameBlend(0.025, 0.025))
    return TaskTrajectory(path, profile or seventh_degree_polynomial(), 0.43)


@dataclass(frozen=True)
class Pointer:
    """A telescope at a base: its one angle as both joints, modulo 2π; the margin is its length."""

    base: tuple[float, float]
    required: float = 0.0

    def joints(self, x: Jet, y: Jet) -> tuple[Jet, Jet]:
        angle = arctan2(y - self.base[1], x - self.base[0])
        return angle, angle + 4.0 * math.pi

    def margins(self, position: RealArray) -> tuple[Margin, ...]:
        return (Margin("length", "m", np.hypot(*(position - self.base).T), self.required),)


@pytest.mark.parametrize("below", [0.01, 1e-3, 1e-5, 1e-8])
def test_angles_are_continuous_however_fast_they_turn(below: float) -> None:
    """Protects continuity across ±π, next to a base as well, where half a turn takes less than a sample's time."""
    motion = TaskTrajectory(
        PickAndPlacePath((-0.2, 0.0), (0.0, -1.0), 0.05, 0.4, LameBlend(0.05, 0.05)), seventh_degree_polynomial(), 1.0
    )
    trajectory = JointTrajectory(motion, Pointer((0.0, -0.05 + below)))
    start, end = trajectory.evaluate([0.0, 1.0], 0)[0]
    inner = math.atan2(0.05 - below, 0.2)
    np.testing.assert_allclose(end - start, math.pi + 2.0 * inner, rtol=1e-14)
    random = np.random.default_rng(1).permutation(np.linspace(0.0, 1.0, 501))
    shuffled = trajectory.evaluate(random, 0)[0]
    ordered = shuffled[np.argsort(random)]
    assert np.all(np.diff(ordered, axis=0) > -1e-12)  # turns one way: no jump back by 2π
    assert np.all(ordered <= end + 1e-12)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("base", [0.0, 0.01234, -0.0777])
def test_the_worst_point_is_located_exactly(base: float, side: float) -> None:
    """Protects the message: the nearest approach to a base is found to rounding, between whichever samples it lies."""
    kinematics = Pointer((base, 0.295 + 0.05 * side), required=0.06)
    with pytest.raises(TrajectoryError) as caught:
        JointTrajectory(task(), kinematics)
    message = str(caught.value)
    found = re.match(
        r"length is (\S+) m at \(x, y\) = \((\S+), (\S+)\) m, t = (\S+) s; it must be at least 0.06 m along", message
    )
    assert found, message
    value, x, y, time = map(float, found.groups())
    assert value == pytest.approx(0.05, rel=1e-5)
    assert x == pytest.approx(base, abs=2e-6)
    assert y == pytest.approx(0.295, abs=1e-6)
    position = task().evaluate(time, 0)[0, 0]
    np.testing.assert_allclose(position, [base, 0.295], rtol=0, atol=1e-5)
    assert "\n" not in message


def test_a_narrow_violation_between_samples_is_found() -> None:
    """Protects planning against margins that fall short for a moment only: 1 part in 10⁹ below what is required."""
    JointTrajectory(task(), Pointer((0.0123, 0.345), required=0.05 * (1.0 - 1e-9)))
    with pytest.raises(TrajectoryError, match=r"length is 0.05 m"):
        JointTrajectory(task(), Pointer((0.0123, 0.345), required=0.05 * (1.0 + 1e-9)))


def test_undefined_margins_are_violations_but_named_last() -> None:
    """Protects against NaN: a margin that isn't defined somewhere is violated there; a defined one tells more."""

    @dataclass(frozen=True)
    class Partial(Pointer):
        required: float = 0.1

        def margins(self, position: RealArray) -> tuple[Margin, ...]:
            (length,) = Pointer.margins(self, position)
            sine = Margin("sine", "1", np.where(length.values > 0.2, 0.5, np.nan), 0.02)
            return sine, replace(length, required=self.required)

    with pytest.raises(TrajectoryError, match=r"sine is undefined at .* at least 0.02 along"):
        JointTrajectory(task(), Partial((0.0, 0.4), required=0.0))
    with pytest.raises(TrajectoryError, match=r"length is 0.105 m at .* at least 0.2 m"):
        JointTrajectory(task(), Partial((0.0, 0.4), required=0.2))


MODE = Oscillator(57.3, 0.08)
SHAPED_PROFILES = [
    {"kind": "poly7"},
    {"kind": "bang-bang"},
    {"kind": "trapezoidal", "ramp": 0.25},
    {"kind": "cycloidal"},
]


@pytest.fixture(scope="module", params=SHAPED_PROFILES, ids=lambda profile: profile["kind"])
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
