"""A trajectory by look-up is the trajectory, and many times as fast for a few points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from flexfmu.cosim.engine.trajectory_slave import TabulatedTrajectory, TrajectorySlave
from flexfmu.cosim.experiment.cycles import ThereAndBack
from flexfmu.trajectories.path import LameBlend, PickAndPlacePath
from flexfmu.trajectories.profiles import bang_bang
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory

PATH = PickAndPlacePath((-0.175, 0.32), (0.0, -1.0), 0.025, 0.35, LameBlend(0.025, 0.025))


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    """A motion whose acceleration jumps."""
    return TaskTrajectory(PATH, bang_bang(), 0.43)


@pytest.fixture(scope="module")
def table(trajectory: Trajectory) -> TabulatedTrajectory:
    """The same by look-up."""
    return TabulatedTrajectory(trajectory)


@pytest.mark.parametrize("side", ["left", "right"])
def test_it_is_the_trajectory(trajectory: Trajectory, table: TabulatedTrajectory, side: str) -> None:
    """Position, velocity and acceleration to rounding, on both sides of breakpoints and at rest before and after; higher
    derivatives nearly."""
    random = np.random.default_rng(3).uniform(-0.1, 0.6, 300)
    times = np.concatenate([random, trajectory.breakpoints])
    exact, found = trajectory.evaluate(times, 6, side), table.evaluate(times, 6, side)  # type: ignore[arg-type]
    error = abs(found - exact).max(axis=(1, 2)) / abs(exact).max(axis=(1, 2))
    assert (error < [1e-13, 1e-13, 1e-13, 1e-10, 1e-8, 1e-6, 1e-4]).all(), error


def test_repeated_motions_too(trajectory: Trajectory) -> None:
    """There and back, with breakpoints that two motions share."""
    motion = ThereAndBack(trajectory, 0.0, 2)
    times = np.array(motion.breakpoints)
    table = TabulatedTrajectory(motion)
    for side in ("left", "right"):
        np.testing.assert_allclose(
            table.evaluate(times, 2, side), motion.evaluate(times, 2, side), rtol=0.0, atol=1e-11
        )


def streamed(trajectory: Trajectory, times: np.ndarray) -> TrajectorySlave:
    """A slave that has been asked for points before, and is now asked for these."""
    slave = TrajectorySlave(trajectory, ("x", "y"), "m")
    slave.prepare(np.linspace(0.0, 0.43, 20))
    slave.prepare(times)
    return slave


@pytest.mark.parametrize("width", [2e-4, 4e-3, 2e-2])
def test_a_chosen_step_gets_the_same_polynomial(trajectory: Trajectory, width: float) -> None:
    """Whether points are few or many: the same references throughout the step, on long ones as exactly as the polynomial
    itself follows the trajectory."""
    begin = 0.0712
    few = begin + width * np.array([0.0, 0.5, 1.0])
    many = np.concatenate([few, np.linspace(0.3, 0.4, 20)])
    within = np.linspace(0.0, 0.5 * width, 20)
    found, exact = (streamed(trajectory, times).announced[0] for times in (few, many))
    powers = np.array([within**j for j in range(10)]) / np.cumprod([1.0, *range(1, 10)])[:, None]
    values = [np.einsum("jn,jv->vn", powers, polynomial) for polynomial in (found, exact)]
    truth = trajectory.evaluate(begin + within, 2).swapaxes(1, 2).reshape(6, -1)
    own = abs(values[1] - truth).max(axis=1)
    scale = np.repeat(abs(trajectory.evaluate(np.linspace(0.0, 0.43, 200), 2)).max(axis=(1, 2)), 2)
    assert (abs(values[0] - values[1]).max(axis=1) < 3e-13 * scale + 0.01 * own).all()


def test_choosing_steps_is_cheap(
    trajectory: Trajectory, table: TabulatedTrajectory, count_calls: Callable[..., int]
) -> None:
    """Three points take a fraction of the calls that the trajectory's series need."""
    times = np.array([0.1, 0.101, 0.102])
    exact, looked_up = (count_calls(lambda each=each: each.evaluate(times, 6)) for each in (trajectory, table))
    assert looked_up < 0.25 * exact
