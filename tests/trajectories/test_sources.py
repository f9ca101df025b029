"""Motions of ruckig, toppra and scipy: the same numbers, and nothing else between the knots."""

from __future__ import annotations

from pathlib import Path
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

from flexfmu.trajectories.piecewise import PiecewisePolynomial
from flexfmu.trajectories.sources import from_ruckig, from_scipy, from_toppra
from flexfmu.trajectories.table import read_table, write_table

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


def test_a_table_holds_them(tmp_path: Path) -> None:
    """Written and read they are the same motion, with the same breakpoints, in a scene's file too."""
    motion = from_ruckig(calculated(limits_of()))
    write_table(tmp_path / "motion.csv", motion)
    found = read_table(tmp_path / "motion.csv").trajectory()
    instants = np.linspace(0.0, motion.duration, 300)
    for order, scale in enumerate((1e-14, 1e-12, 1e-9)):
        np.testing.assert_allclose(found.evaluate(instants, 2)[order], motion.evaluate(instants, 2)[order], atol=scale)
    assert found.breakpoints == pytest.approx(motion.breakpoints)
    assert found.coordinates == "joints"


def test_a_table_holds_b_splines(tmp_path: Path) -> None:
    """A planner's B-spline of degree 5 from rest to rest is its table, one row for each knot."""
    random, knots = np.random.default_rng(4), np.concatenate([[0.0] * 5, np.linspace(0.0, 0.5, 9), [0.5] * 5])
    controls = random.normal(size=(len(knots) - 6, 2))
    controls[1:3], controls[-3:-1] = controls[0], controls[-1]
    motion = from_scipy(BSpline(knots, controls, 5))
    write_table(tmp_path / "motion.csv", motion)
    table = read_table(tmp_path / "motion.csv")
    assert len(table.time) == 9
    instants = np.linspace(0.0, 0.5, 300)
    for order, scale in enumerate((1e-13, 1e-11, 1e-8, 1e-6)):
        found, expected = (each.evaluate(instants, 3)[order] for each in (table.trajectory(), motion))
        np.testing.assert_allclose(found, expected, atol=scale)
