"""A trajectory as a slave: exact at communication points and on both sides of jumps, close in between."""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from flexfmu.cosim.engine.master.grid import time_grid
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.path import LameBlend, PickAndPlacePath
from flexfmu.trajectories.profiles import bang_bang
from flexfmu.trajectories.trajectory import TaskTrajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ramp:
    """Two axes at rest that accelerate with 3 and 5 rad/s2 from the first breakpoint to the last; in between the
    acceleration jumps by another 1 rad/s2 at each breakpoint."""

    breakpoints: tuple[float, ...]

    @property
    def duration(self) -> float:
        return self.breakpoints[-1]

    def evaluate(self, time: ArrayLike, order: int = 2, side: str = "right") -> Array:
        t = np.atleast_1d(np.asarray(time, dtype=float))
        result = np.zeros((order + 1, t.size, 2))
        for start in self.breakpoints[:-1]:
            moving = t >= start if side == "right" else t > start
            for k in range(3):
                result[k, moving, :] += ((t[moving] - start) ** (2 - k) / factorial(2 - k))[:, None]
        return result


@dataclass(frozen=True)
class Swing:
    """Two axes that swing as sin(5 t) and cos(7 t) [rad] for ten seconds."""

    duration: float = 10.0
    breakpoints: tuple[float, ...] = (0.0, 10.0)

    def evaluate(self, time: ArrayLike, order: int = 2, side: str = "right") -> Array:
        t = np.atleast_1d(np.asarray(time, dtype=float))
        axes = ((5.0, 0.0), (7.0, np.pi / 2))
        return np.array(
            [[w**k * np.sin(w * t + phase + k * np.pi / 2) for w, phase in axes] for k in range(order + 1)]
        ).swapaxes(1, 2)


def started(slave: TrajectorySlave, times: Array) -> TrajectorySlave:
    """The slave at the first of the communication points."""
    slave.prepare(times)
    slave.initialize(times[0], times[-1], None)
    return slave


def current(slave: TrajectorySlave, order: int) -> Array:
    """(order + 1, 6): references with derivatives."""
    signals, everything = np.zeros((order + 1, 6)), np.arange(6)
    slave.get(everything, signals[0])
    slave.get_derivatives(everything, signals[1:])
    return signals


def worst_error(order: int, step: float) -> float:
    """Largest error of the position references within steps of that size, of degree ``order``."""
    times, worst = np.arange(0.0, 1.0, step), 0.0
    slave = started(TrajectorySlave(Swing(), order=order), times)
    for time in times[:-1]:
        slave.announce(time)
        polynomial = current(slave, order)[:, :2]
        for tau in np.linspace(0.0, step, 7):
            value = sum(polynomial[k] * tau**k / factorial(k) for k in range(order + 1))
            worst = max(worst, float(abs(value - Swing().evaluate(time + tau)[0, 0]).max()))
        slave.step(time, step)
    return worst


@pytest.mark.parametrize("order", range(10))
def test_error_within_a_step_falls_with_the_order(order: int) -> None:
    """A polynomial of degree k is off by O(h^(k + 1)) within a step: what a tool that sends fewer derivatives loses."""
    slope = np.log2(worst_error(order, 0.2) / worst_error(order, 0.1))
    assert slope == pytest.approx(order + 1, abs=0.5)


def test_both_sides_of_a_jump() -> None:
    """Before a breakpoint the references are the left limits, after it the right ones; before the start at rest."""
    slave = started(TrajectorySlave(Ramp((0.0, 0.5, 1.0))), np.array([0.0, 0.5, 1.0]))
    assert current(slave, 2)[0, 4] == 0.0
    slave.announce(0.0)
    assert current(slave, 9)[0, 4] == 1.0
    slave.step(0.0, 0.5)
    assert current(slave, 2)[0, 4] == 1.0
    slave.announce(0.5)
    assert current(slave, 9)[0, 4] == 2.0


def test_breakpoints_at_one_communication_point() -> None:
    """Breakpoints nearer than rounding share a communication point: left of the first, right of the last."""
    ramp = Ramp((0.0, 0.5, 0.5 + 1e-13, 1.0))
    grid = time_grid(0.0, 1.0, 0.1, ramp.breakpoints)
    assert grid.times.size == 11
    slave = started(TrajectorySlave(ramp), grid.times)
    for time in grid.times[:5]:
        slave.announce(time)
        slave.step(time, 0.1)
    assert current(slave, 2)[0, 4] == 1.0
    slave.announce(grid.times[5])
    assert current(slave, 9)[0, 4] == 3.0


@pytest.mark.parametrize("order", [4, 6, 8, 9])
def test_few_points_are_as_good_as_many(order: int) -> None:
    """A master that chooses its steps on the way asks for a few points again and again: it gets what a grid of many gives,
    whatever the degree."""
    times = np.arange(0.0, 1.0, 0.05)
    many = started(TrajectorySlave(Swing(), order=order), times)
    few = started(TrajectorySlave(Swing(), order=order), times)
    few.prepare(times[5:8])
    share = np.array([0.05**k / factorial(k) for k in range(order + 1)])[:, None]  # what a derivative makes of a step
    np.testing.assert_allclose(share * few.announced[0], share * many.announced[5], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(share[:5] * few.ended[1], share[:5] * many.ended[6], rtol=0.0, atol=1e-11)


class Counted:
    """A motion that counts its evaluations."""

    def __init__(self) -> None:
        path = PickAndPlacePath((-0.175, 0.32), (0.0, -1.0), 0.025, 0.35, LameBlend(0.025, 0.025))
        self.motion, self.evaluations = TaskTrajectory(path, bang_bang(), 1.0), 0
        self.duration, self.breakpoints = self.motion.duration, self.motion.breakpoints

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> Array:
        self.evaluations += 1
        return self.motion.evaluate(time, order, side)


@pytest.mark.parametrize("order", [3, 9])
def test_standstill_is_calculated_once(order: int) -> None:
    """Minutes after the motion cost nothing, and have the same bits; points that touch the motion are calculated."""
    slave, again = TrajectorySlave(motion := Counted(), order=order), TrajectorySlave(Counted(), order=order)
    grids = [start + 0.01 * np.arange(50) for start in (0.6, 1.0, 1.3, 7.1, 100.25)]
    for times in grids[:3]:
        slave.prepare(times)
    known = motion.evaluations
    for times in grids[3:]:
        slave.prepare(times)
    assert motion.evaluations == known
    for times in grids:
        slave.prepare(times)
        again.follow(again.trajectory)
        again.prepare(times)
        np.testing.assert_array_equal(slave.announced, again.announced)
        np.testing.assert_array_equal(slave.ended, again.ended)
        slave.announce(times[0])
    assert motion.evaluations == known
