"""Step control: the error that was asked for is kept, marks are hit, rejected steps leave no trace."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from python_slave import PythonSlave

from flexfmu.cosim.engine.errors import SlaveError
from flexfmu.cosim.engine.master.couplings import Algorithm, GaussSeidel, Implicit, Jacobi
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling, fitted
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.trajectories.path import LameBlend, PickAndPlacePath
from flexfmu.trajectories.profiles import bang_bang
from flexfmu.trajectories.trajectory import TaskTrajectory

Factory = Callable[..., Any]


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The command that prints the table, with its three systems and their references, good for 2e-5."""
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    module = importlib.import_module("step_control")
    monkeypatch.setattr(module, "REFERENCE_STEP", 2e-4)
    return module


@pytest.mark.parametrize(
    ("case", "order", "tolerances"),
    [
        ("oscillator", 0, (1e-1, 1e-2)),
        ("oscillator", 1, (1e-2, 1e-3, 1e-4)),
        ("oscillator", 2, (1e-2, 1e-4, 1e-6)),
        ("robot led by a trajectory", 1, (1e-2,)),
    ],
)
def test_the_error_is_what_was_asked_for(benchmark: Any, case: str, order: int, tolerances: tuple[float, ...]) -> None:
    """The largest error over the run is 0.1 to 3 times the tolerance: not a tenth, which would be wasted time; with a
    closed form, with stiff modes and a force that jumps, and with a slave that predicts its outputs."""
    for tolerance in tolerances:
        error, _, _ = benchmark.controlled(benchmark.CASES[case], order, tolerance, repetitions=1)
        assert 0.1 * tolerance < error < 3.0 * tolerance


def test_the_work_is_that_of_fixed_steps(benchmark: Any, count_calls: Callable[[Callable[[], object]], int]) -> None:
    """With the steps that control chooses for an undamped oscillator, where equal ones are best, the master makes at most
    4 times the calls of a run with as many equal steps."""
    system = benchmark.CASES["oscillator"].system(1)
    chosen = simulate(system, 2.0, 1e-3, step_control=StepDoubling(1e-3))
    calls = count_calls(lambda: simulate(system, 2.0, 1e-3, step_control=StepDoubling(1e-3)))
    assert calls < 4 * count_calls(lambda: simulate(system, 2.0, 2.0 / chosen.steps))


@pytest.mark.parametrize(
    ("algorithm", "order", "tolerances"),
    [
        (GaussSeidel(), 0, (3e-2, 1e-2)),
        (GaussSeidel(), 1, (1e-2, 1e-3, 1e-4)),
        (GaussSeidel(), 3, (1e-3, 1e-5, 1e-7)),
        (Jacobi(), 2, (1e-3, 1e-4, 1e-5)),
        (Implicit(), 0, (1e-2, 1e-3)),
        (Implicit(), 1, (1e-3, 1e-5, 1e-7)),
    ],
)
def test_the_error_is_kept(
    split_oscillator: Factory, algorithm: Algorithm, order: int, tolerances: tuple[float, ...]
) -> None:
    """The error over the whole run stays below what was asked for, and not far below; signals have magnitude 1."""
    for tolerance in tolerances:
        oscillator, control = split_oscillator(order), StepDoubling(tolerance=tolerance)
        result = simulate(oscillator.system(), 2.0, 0.01, algorithm=algorithm, step_control=control)
        assert result.outcome is Outcome.COMPLETED, result.message
        assert 0.02 * tolerance < oscillator.error(result.recording) < tolerance
        assert [slave.saved for slave in oscillator.slaves] == [0, 0]


RING = [("left.x", "right.u"), ("right.x", "left.u")]


class Kicks(PythonSlave):
    """Does nothing but has instants that must be hit."""

    name = "kicks"
    variables = (SlaveVariable("y", "output"),)

    def __init__(self, breakpoints: tuple[float, ...]) -> None:
        super().__init__()
        self.breakpoints = breakpoints

    def save(self) -> object:
        return None

    def restore(self, state: object) -> None: ...


def test_marks_are_hit(split_oscillator: Factory) -> None:
    """Chosen steps land on every mark exactly; each mark has two sides, every other point one."""
    marks = (1.0 / 3.0, 0.7, 0.7 + 1e-5, 1.234567)
    control = StepDoubling(tolerance=1e-5)
    system = connect([*split_oscillator(2).slaves, Kicks(marks)], RING)
    result = simulate(system, 2.0, 0.01, step_control=control)
    times, counts = np.unique(result.recording.time, return_counts=True)
    assert set(times[counts == 2].tolist()) == set(marks)
    assert result.delays[1].seconds == pytest.approx(np.diff(times).max(), rel=1e-6)


def test_smallest_step(split_oscillator: Factory) -> None:
    """A tolerance that the smallest step can't keep ends the run with the signal's name and a remedy."""
    control = StepDoubling(tolerance=1e-9, smallest=1e-3)
    result = simulate(split_oscillator(0).system(), 1.0, 0.01, step_control=control)
    assert result.outcome is Outcome.STEP_TOO_SMALL
    assert "the coupling error of" in result.message
    assert "take a larger tolerance" in result.message


class Impatient(Kicks):
    """Can't make steps above a limit."""

    limit = 0.3

    def step(self, time: float, step: float) -> None:
        if step > self.limit:
            raise SlaveError(self.name, "this step is too long for me")


def test_rejected_steps_leave_no_trace(split_oscillator: Factory) -> None:
    """A run whose first step is too long for somebody, and is taken back at its end, gives bit by bit what a run gives
    that begins with the shorter step."""
    results = []
    for first in (0.5, 0.1):
        system = connect([*split_oscillator(3).slaves, Impatient(())], RING)
        control = StepDoubling(tolerance=1e-3, smallest=1e-6)
        results.append(simulate(system, 2.0, first, step_control=control))
    back, straight = results
    assert back.rejected > straight.rejected
    np.testing.assert_array_equal(back.recording.time, straight.recording.time)
    for name in ("left.x", "left.v", "right.x", "right.v"):
        np.testing.assert_array_equal(back.recording[name].values, straight.recording[name].values)


def test_a_failing_slave_gets_a_smaller_step() -> None:
    """A slave that only fails in long steps is asked again; one that never manages has the last word."""
    slave = Impatient(())
    result = simulate(connect([slave], []), 1.0, 0.5, step_control=StepDoubling())
    assert result.outcome is Outcome.COMPLETED
    assert result.rejected > 0
    slave.limit = 0.0
    result = simulate(connect([slave], []), 1.0, 0.5, step_control=StepDoubling())
    assert result.outcome is Outcome.STEP_FAILED
    assert result.message == "kicks failed at 0 s: this step is too long for me"


def test_a_trajectory_is_announced_for_every_chosen_step() -> None:
    """A slave that predicts its outputs follows the master's steps, back and forth: at every point it is on its trajectory,
    on both sides of its jumps."""
    path = PickAndPlacePath((-0.175, 0.32), (0.0, -1.0), 0.025, 0.35, LameBlend(0.025, 0.025))
    trajectory = TaskTrajectory(path, bang_bang(), 0.43)
    source = TrajectorySlave(trajectory, ("x", "y"), "m")
    target = Impatient(())
    target.limit = 0.013
    target.variables = (*target.variables, SlaveVariable("u", "input", "m"))
    target.memory, target.max_input_order = np.zeros(2), 9
    target.set_derivatives = lambda indices, derivatives: None
    system = connect([target, source], [("trajectory.x.reference.position", "kicks.u")])
    result = simulate(system, 0.5, 0.1, step_control=StepDoubling())
    assert result.rejected > 0, result.message
    time = result.recording.time
    last = np.append(np.diff(time) > 0.0, True)
    right = trajectory.evaluate(time[last], 2, side="right")
    names = [f"trajectory.{axis}.reference.{kind}" for kind in ("position", "acceleration") for axis in "xy"]
    recorded = np.stack([result.recording[name].values[last] for name in names])
    np.testing.assert_allclose(recorded, np.concatenate([right[0].T, right[2].T]), rtol=1e-12, atol=1e-12)
    assert set(trajectory.breakpoints) <= set(time.tolist())


def test_equal_steps_to_a_mark() -> None:
    """The rest of the way to a mark is split into equal steps, without a tiny one at the end."""
    assert fitted(0.3, 1.0) == 0.25
    assert fitted(0.1, 0.3 + 1e-17) == pytest.approx(0.1)
    assert fitted(5.0, 1.0) == 1.0


@pytest.mark.parametrize(("error", "change"), [(0.0, 4.0), (1e-9, 4.0), (0.45, 2.0), (16.0, 0.2), (1e9, 0.2)])
def test_steps_change_within_limits(error: float, change: float) -> None:
    """A step without any error, as before a motion begins, doesn't let the next one run away, nor does a jump stop it;
    between, the next step aims at 0.9 of what the error of first order allows."""
    assert StepDoubling().next_step(0.01, error, 1) == pytest.approx(0.01 * change)
    assert StepDoubling(largest=0.015).next_step(0.01, error, 1) == pytest.approx(min(0.01 * change, 0.015))
