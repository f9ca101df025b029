"""Motions of users' classes, ruckig, toppra and scipy are the same motions here."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest
import ruckig
import toppra
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.piecewise import PiecewisePolynomial
from flexfmu.trajectories.sources import as_trajectory, from_ruckig, from_scipy, from_toppra

DURATION = 0.4


class Cycloid:
    """σ of the cycloidal profile along a line of 0.2 m, and a cosine across."""

    duration: Any = DURATION

    def position(self, time: float) -> tuple[float, float]:
        """x and y [m]."""
        u = 2.0 * pi * time / DURATION
        return 0.2 * (u - sin(u)) / (2.0 * pi), 0.01 * cos(u)


class BangBang:
    """Constant acceleration, then constant deceleration."""

    duration = DURATION
    breakpoints: tuple[float, ...] = (0.2,)

    def position(self, time: float) -> tuple[float, float]:
        """x and y [m]."""
        return (time**2, 0.0) if time < 0.2 else (0.08 - (DURATION - time) ** 2, 0.0)


class Sudden(BangBang):
    """Deceleration that begins where no interval ends by halving."""

    breakpoints = (0.13,)

    def position(self, time: float) -> tuple[float, float]:
        """x and y [m]."""
        rest, speed = DURATION - time, 2.0 * 0.13
        if time < 0.13:
            return time**2, 0.0
        return 0.13**2 + 0.5 * speed * (DURATION - 0.13) - 0.5 * speed * rest**2 / (DURATION - 0.13), 0.0


def changed(base: type, **members: Any) -> Any:
    """An instance of the class with other members."""
    return type(base.__name__, (base,), members)()


def test_polynomials_have_the_derivatives_of_the_formula() -> None:
    """Acceleration to 1e-9 and the fourth derivative to 1e-5 of their largest values, at both ends too."""
    motion = as_trajectory(Cycloid())
    time = np.linspace(0.0, DURATION, 401)[1:-1]
    w = 2.0 * pi / DURATION
    u = w * time
    exact = np.array(
        [
            [0.2 * (u - np.sin(u)) / (2.0 * pi), 0.01 * np.cos(u)],
            [0.2 / DURATION * (1.0 - np.cos(u)), -0.01 * w * np.sin(u)],
            [0.2 / DURATION * w * np.sin(u), -0.01 * w**2 * np.cos(u)],
            [0.2 / DURATION * w**2 * np.cos(u), 0.01 * w**3 * np.sin(u)],
            [-0.2 / DURATION * w**3 * np.sin(u), 0.01 * w**4 * np.cos(u)],
        ]
    ).swapaxes(1, 2)
    found = motion.evaluate(time, 12)
    for order, tolerance in enumerate((1e-13, 1e-12, 1e-9, 1e-7, 1e-5)):
        largest = abs(exact[order]).max()
        np.testing.assert_allclose(found[order], exact[order], rtol=0, atol=tolerance * largest)
    np.testing.assert_array_equal(found[11:], 0.0)


@pytest.mark.parametrize("extent", [0.0, 1e-9, 1e-6, 1e-3])
def test_small_motions_and_standstills(extent: float) -> None:
    """Positions to rounding, and accelerations as exact as rounded positions give them by Markov's inequality, n²(n² - 1)/3 / (half an
    interval)²; a standstill has none."""

    class Small(Cycloid):
        def position(self, time: float) -> tuple[float, float]:
            x, y = super().position(time)
            return -0.1 + extent * x, 0.3 + extent * y

    motion, large = as_trajectory(Small()), as_trajectory(Cycloid())
    time = np.linspace(0.0, DURATION, 101)
    found, exact = motion.evaluate(time, 2), extent * large.evaluate(time, 2)
    exact[0] += -0.1, 0.3
    np.testing.assert_allclose(found[0], exact[0], rtol=0, atol=1e-15)
    if extent:
        rounding = 2.0 * np.finfo(float).eps * 0.3 * 100.0 * 33.0 / (0.5 * np.diff(motion.breakpoints).min()) ** 2
        np.testing.assert_allclose(found[2], exact[2], rtol=0, atol=rounding)
    else:
        np.testing.assert_array_equal(found[1:], 0.0)


def test_breakpoints_have_two_limits() -> None:
    """The acceleration jumps where the class says, and only there."""
    motion = as_trajectory(BangBang())
    assert motion.breakpoints == (0.0, 0.2, DURATION)
    sides = [motion.evaluate(0.2, 2, side)[:, 0, 0] for side in ("left", "right")]  # type: ignore[arg-type]
    np.testing.assert_allclose(sides, [[0.04, 0.4, 2.0], [0.04, 0.4, -2.0]], rtol=1e-9)
    assert 0.13 in as_trajectory(Sudden()).breakpoints
    assert as_trajectory(changed(Cycloid, duration=lambda self: DURATION)).duration == DURATION  # a method does too


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (Cycloid, r"an own motion is an object of its class: give Cycloid\(\) in place of Cycloid"),
        (object(), "object has no `duration`: an own motion needs `duration`"),
        (changed(Cycloid, duration=0.0), "duration of the own motion must be above zero and finite, got 0 s"),
        (changed(Cycloid, position=lambda self, time: 1.0), r"position\(0\) must return two numbers, got 1\.0"),
        (changed(Cycloid, position=lambda self, time: (np.nan, 0.0)), r"position\(0\) must return two finite numbers"),
        (changed(Cycloid, position=lambda self, time: (time, 0.0)), r"velocity of the own motion jumps by 1 per second at 0(\.4)? s"),
        (changed(Sudden, breakpoints=()), r"isn't smooth near 0\.13\d* s: add this instant to its `breakpoints`"),
    ],
)  # fmt: skip
def test_what_is_no_motion_is_refused(motion: Any, message: str) -> None:
    """What is wrong, where, and what to do."""
    with pytest.raises(TrajectoryError, match=message):
        as_trajectory(motion)


toppra.setup_logging("WARNING")

ANGLES = [[3.24, 1.17], [2.5, 0.6], [2.6, 0.2], [1.9, -0.1]]
"""Waypoints of both motors [rad]."""


def calculated(limits: Any) -> Any:
    """The motion of ruckig."""
    motion = ruckig.Trajectory(len(limits.max_velocity))
    ruckig.Ruckig(len(limits.max_velocity)).calculate(limits, motion)
    return motion


def limits_of(*, jerk: float = 8000.0) -> Any:
    """From rest to rest within limits."""
    limits = ruckig.InputParameter(2)
    limits.current_position, limits.target_position = ANGLES[0], ANGLES[-1]
    limits.max_velocity, limits.max_acceleration, limits.max_jerk = [12.0, 14.0], [300.0, 200.0], [jerk, jerk]
    return limits


def assert_same(motion: PiecewisePolynomial, original: Any) -> None:
    """Values, rates and accelerations of a ruckig trajectory."""
    instants = np.linspace(0.0, motion.duration, 203)[1:-1]
    expected = np.array([original.at_time(time) for time in instants.tolist()]).swapaxes(0, 1)
    assert motion.duration == original.duration
    for order, (found, each) in enumerate(zip(motion.evaluate(instants, 2), expected, strict=True)):
        np.testing.assert_allclose(found, each, rtol=1e-11, atol=1e-11 * 100.0**order)


@pytest.mark.parametrize("synchronization", ["Time", "No", "Phase"])
@pytest.mark.parametrize("jerk", [8000.0, np.inf])
def test_ruckig(synchronization: str, jerk: float) -> None:
    """Also where an axis waits for the other, and where the acceleration jumps; jerks stay constant between breakpoints."""
    limits = limits_of(jerk=jerk)
    limits.synchronization = getattr(ruckig.Synchronization, synchronization)
    original = calculated(limits)
    motion = from_ruckig(original)
    assert_same(motion, original)
    assert abs(motion.evaluate(motion.breakpoints[:-1], 3)[3]).max() == pytest.approx(0.0 if jerk == np.inf else jerk)
    assert abs(motion.evaluate(np.linspace(0.0, motion.duration, 50), 4)[4]).max() == 0.0


@settings(max_examples=50)
@given(*[st.floats(-2.0, 2.0)] * 6)
def test_ruckig_from_any_state(p: float, q: float, v: float, w: float, a: float, b: float) -> None:
    """Braking phases before the motion, and both axes with knots of their own."""
    limits = limits_of()
    limits.current_position, limits.current_velocity, limits.current_acceleration = (
        [p, q],
        [8 * v, 8 * w],
        [200 * a, 100 * b],
    )
    original = calculated(limits)
    assert_same(from_ruckig(original), original)


def test_toppra() -> None:
    """Cubic splines of time."""
    path = toppra.SplineInterpolator([0.0, 0.37, 0.71, 1.0], ANGLES)
    limits = [JointVelocityConstraint([[-12.0, 12.0]] * 2), JointAccelerationConstraint([[-300.0, 300.0]] * 2)]
    original = TOPPRA(limits, path).compute_trajectory(0, 0)
    motion = from_toppra(original)
    assert (motion.duration, motion.degree) == (pytest.approx(original.duration), 3)
    instants = np.linspace(0.0, original.duration, 301)[1:-1]
    for order, found in enumerate(motion.evaluate(instants, 2)):
        np.testing.assert_allclose(found, original(instants, order), rtol=1e-11, atol=1e-11 * 100.0**order)


def test_scipy() -> None:
    """A B-spline with its knots beyond the base interval, and one whose time doesn't begin at 0."""
    random = np.random.default_rng(2)
    times = np.linspace(3.0, 5.0, 12)
    for spline in (
        make_interp_spline(times, random.normal(size=(12, 2)), 5),
        CubicSpline(times, random.normal(size=(12, 2)), bc_type="clamped"),
        BSpline(np.arange(1.0, 10.0), random.normal(size=(5, 2)), 3),
    ):
        motion = from_scipy(spline, "end-effector")
        start, end = (spline.t[spline.k], spline.t[-spline.k - 1]) if isinstance(spline, BSpline) else (3.0, 5.0)
        assert motion.duration == pytest.approx(end - start)
        instants = np.linspace(start, end, 101)[1:-1]
        for order, found in enumerate(motion.evaluate(instants - start, 3)):
            np.testing.assert_allclose(found, spline(instants, order), rtol=1e-9, atol=1e-8)
