"""A motion there and back: smooth where it should be, on both sides of every breakpoint."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from flexfmu.cosim.experiment.cycles import ThereAndBack, repeated
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import Trajectory


def bang_bang(dwell: float) -> MotionPlan:
    """Three cycles of a motion whose acceleration jumps."""
    changes = {"trajectory.dwell": dwell, "trajectory.profile": {"kind": "bang-bang"}}
    return repeated(plan(load_scene("barnard2012-6kg").replace(changes)), 3)


@pytest.mark.parametrize("dwell", [0.0, 0.1])
def test_limits_are_those_of_the_neighbourhood(dwell: float) -> None:
    """Left and right limits at a breakpoint are what the motion comes to from either side, in every cycle."""
    motion = bang_bang(dwell).joints
    near = 1e-9
    points = np.array(motion.breakpoints)
    assert np.all(np.diff(points) > 0.0)
    np.testing.assert_allclose(motion.evaluate(points, 2, "left"), motion.evaluate(points - near, 2), atol=1e-5)
    np.testing.assert_allclose(motion.evaluate(points, 2, "right"), motion.evaluate(points + near, 2), atol=1e-5)


@pytest.mark.parametrize("dwell", [0.0, 0.1])
def test_it_comes_back(dwell: float) -> None:
    """After each cycle the joints are where they were; the way back is the way there, reversed in time."""
    motion = bang_bang(dwell).joints
    assert isinstance(motion, ThereAndBack)
    there = np.linspace(0.01, 0.42, 20)
    back = 2 * motion.motion.duration + motion.dwell - there
    forward, backward = motion.evaluate(there, 2), motion.evaluate(motion.period + back, 2)
    np.testing.assert_allclose(backward[::2], forward[::2], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(backward[1], -forward[1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(motion.evaluate(motion.duration, 0), motion.evaluate(0.0, 0), atol=1e-12)


def test_late_cycles_have_the_limits_of_early_ones() -> None:
    """After hours, the rounding of the time is larger than what a motion takes for one instant: each side of a breakpoint must
    still be told from the other."""
    joints = plan(load_scene("barnard2012-6kg")).joints
    motion = ThereAndBack(joints, 0.02, 10_000)
    marks = len(joints.breakpoints) * 2
    points = np.array(motion.breakpoints)
    for side in ("left", "right"):
        second = motion.evaluate(points[marks : 2 * marks], 4, side)
        last = motion.evaluate(points[-marks:], 4, side)
        np.testing.assert_array_equal(last, second)


class Counting:
    """A trajectory that counts the evaluated instants."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory, self.count = trajectory, 0
        self.duration, self.breakpoints = trajectory.duration, trajectory.breakpoints

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """As `Trajectory.evaluate`."""
        self.count += np.size(time)
        return self.trajectory.evaluate(time, order, side)


def test_equal_instants_of_all_cycles_are_evaluated_once() -> None:
    """The references of a hundred cycles cost those of one, have the same bits in all cycles, and in the first one those of the
    motion itself."""
    counting = Counting(plan(load_scene("barnard2012-6kg")).joints)
    motion = ThereAndBack(counting, 0.25, 100)
    cycle = round(motion.period / 1e-3)
    times = 1e-3 * np.arange(100 * cycle)
    found = motion.evaluate(times, 6).reshape(7, 100, cycle, 2)
    assert counting.count <= cycle
    np.testing.assert_array_equal(found, np.broadcast_to(found[:, :1], found.shape))
    np.testing.assert_array_equal(found[:, 0, :430], counting.trajectory.evaluate(times[:430], 6))
