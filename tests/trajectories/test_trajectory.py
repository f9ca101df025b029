"""Motion in time: derivatives of any order, one-sided at breakpoints, standstill before and after."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from flexfmu.trajectories.path import Blend, ClothoidPair, LameBlend, PickAndPlacePath, PolarPolynomial
from flexfmu.trajectories.profiles import Profile, bang_bang, seventh_degree_polynomial, trapezoidal
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
def test_each_derivative_is_the_integral_of_the_next(
    blend: Blend, profile: Profile, exact_derivatives: Callable[..., None]
) -> None:
    """Protects every derivative to order 8 and both one-sided limits, by quadrature between breakpoints.

    Between the limits at an interval's ends a derivative changes by the integral of the next one.
    """
    exact_derivatives(planned(blend, profile, height=0.03), 1e-15)


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
