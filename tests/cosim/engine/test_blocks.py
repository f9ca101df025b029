"""The communication points of long runs: in blocks they are the same points, and runs have the same bits; FMUs of other tools, stepped at
their own instants: a fixed-step PID that calculates in fmi2DoStep, and plain ones."""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import pid
from hypothesis import given, settings
from hypothesis import strategies as st
from python_slave import PythonSlave

import flexfmu
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.sampled_slave import FmuTask, SampledFmu, fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master import grid as module
from flexfmu.cosim.engine.master.grid import Clock, GridRules, RunGrid, TimeGrid
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.exchange.ssp.export import export_ssp
from flexfmu.cosim.exchange.ssp.loading import load_ssp
from flexfmu.cosim.experiment.cycles import ThereAndBack
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene


@pytest.fixture
def short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks so short that every run has several."""
    monkeypatch.setattr(module, "BLOCK", 40)
    monkeypatch.setattr(module, "SHORTEST", 10)
    monkeypatch.setattr(module, "KEPT", 3)


def whole(grid: RunGrid) -> TimeGrid:
    """All points of a grid, from its blocks; checks that they join."""
    parts, last = [], None
    for block in grid.blocks():
        parts.append(block.grid if last is None else block.grid.part(slice(1, None)))
        assert last is None or (last.after, last.grid.times[-1]) == (block.grid.times[1], block.grid.times[0])
        last = block
    assert last is not None
    assert last.after is None
    joined = parts[0]
    for part in parts[1:]:
        joined = module._joined(joined, part)
    return joined


@settings(max_examples=100)
@given(
    start=st.floats(-10.0, 10.0),
    count=st.floats(1.0, 1000.0),
    shares=st.lists(st.floats(-0.2, 1.2), max_size=8),
    ratios=st.lists(st.sampled_from([0.25, 1.0, 1.5, 3.0, 7.0]), max_size=2),
    period=st.sampled_from([0.0, 0.1, 0.35, 0.07, 0.1 / 3.0, 0.0777777]),
)
def test_blocks_are_the_whole_grid(
    start: float, count: float, shares: list[float], ratios: list[float], period: float
) -> None:
    """Whatever the marks, clocks and periods: the points of all blocks are those of the whole grid, bit by bit."""
    step = 1e-3
    stop = start + count * step
    marks = [start + share * count * step for share in shares]
    # some marks on ticks, some between two ticks, where blocks are cut
    marks += [start + 20 * step, start + 39.5 * step, start + 79.5 * step + 1e-10]
    clocks = [Clock(f"clock {ratio}", ratio * step, 0.5 * step) for ratio in ratios]
    rules = GridRules(start, stop, step, marks, clocks)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "BLOCK", 40)
        patch.setattr(module, "SHORTEST", 10)
        grid = RunGrid(rules, period)
        found, expected = whole(grid), rules.between()
    np.testing.assert_array_equal(found.times, expected.times)
    np.testing.assert_array_equal(found.marked, expected.marked)
    np.testing.assert_array_equal(found.due, expected.due)
    assert grid.steps == expected.times.size - 1
    assert grid.jumps == expected.marked.sum()
    assert (grid.least_step, grid.largest_step) == (np.diff(expected.times).min(), np.diff(expected.times).max())


class Follower(PythonSlave):
    """Adds up its input; samples every 3 ms if it is to."""

    name = "follower"
    feedthrough = {"y": ()}  # noqa: RUF012
    variables = (SlaveVariable("u", "input", start=0.0), SlaveVariable("y", "output"))

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.memory[1] = 0.0

    def step(self, time: float, step: float) -> None:
        self.memory[1] += self.memory[0] * step


class Sampling(Follower):
    """The same, sampled."""

    sample_time = 3e-3

    def sample(self, time: float) -> None:
        self.memory[1] += self.memory[0] * self.sample_time


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("follower", [Follower, Sampling])
def test_runs_in_blocks_have_the_same_bits(
    short_blocks: None, monkeypatch: pytest.MonkeyPatch, follower: Callable[[], Follower], compiled: bool
) -> None:
    """The references of a run in blocks, and what follows from them, are those of the same run in one block."""
    joints = plan(load_scene("barnard2012-6kg")).joints

    def run() -> tuple[np.ndarray, ...]:
        slaves = [TrajectorySlave(joints), follower()]
        links = [("trajectory.joint1.reference.position", "follower.u")]
        result = simulate(connect(slaves, links), 0.5, 1e-3, compiled=compiled)
        assert result.outcome is Outcome.COMPLETED, result.message
        columns = result.recording.columns.values()
        return result.recording.time, *(each for one in columns for each in (one.values, one.first, one.second))

    found = run()
    monkeypatch.setattr(module, "BLOCK", 10**6)
    for one, other in zip(found, run(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_cycles_share_tables(short_blocks: None) -> None:
    """Memory doesn't grow with the number of cycles: their blocks take the tables of the first one, within rounding errors."""
    motion = ThereAndBack(plan(load_scene("barnard2012-6kg")).joints, 0.01, 20)
    slave = TrajectorySlave(motion)
    system = connect([slave], [])
    grid = module.system_grid(system, 0.0, motion.duration + 0.01, 1e-3, True)
    tables, steps = set[int](), 0
    for block in grid.blocks():
        slave.prepare(block.known)
        tables.add(id(slave.announced))
        expected = motion.evaluate(block.grid.times[1:-1], 2)
        np.testing.assert_allclose(slave.announced[1 : block.steps, 0, :2], expected[0], rtol=0.0, atol=1e-12)
        steps += block.steps
    # 880 ticks a cycle, 22 or 23 blocks each, the first cycle and later ones; the last cycle has its own last block
    assert steps > 20 * 880
    assert len(tables) <= 2 * 23 + 2


def test_a_failure_in_a_later_block_is_reported_there(short_blocks: None) -> None:
    """Steps and time of a failure count from the start of the run."""

    class Tripping(Follower):
        def step(self, time: float, step: float) -> None:
            if time > 0.2995:
                raise InputError("enough")

    for compiled in (True, False):
        slaves = [TrajectorySlave(plan(load_scene("barnard2012-6kg")).joints), Tripping()]
        result = simulate(connect(slaves, []), 0.5, 1e-3, compiled=compiled)
        assert result.outcome is Outcome.STEP_FAILED
        assert "0.3" in result.message
        assert result.recording.time[-1] == 300 * 1e-3


def test_progress_counts_over_all_blocks(short_blocks: None) -> None:
    """Progress rises to 1, in about a hundred reports."""
    for compiled in (True, False):
        told: list[float] = []
        slave = TrajectorySlave(plan(load_scene("barnard2012-6kg")).joints)
        simulate(connect([slave], []), 0.5, 1e-4, compiled=compiled, progress=told.append)
        assert np.all(np.diff(told) > 0.0)
        assert told[-1] == 1.0
        assert 90 <= len(told) <= 100 + 5000 // 40


def test_late_steps_end_at_their_references() -> None:
    """After hours, where the rounding of times changes the lengths of steps, the polynomials still end where the references are."""
    motion = ThereAndBack(plan(load_scene("barnard2012-6kg")).joints, 0.02, 10_000)
    slave = TrajectorySlave(motion)
    marks = np.array(motion.breakpoints)
    early = np.union1d(0.01 * np.arange(1, 90), marks[marks < 0.9])
    late = 7000 * motion.period + early
    errors = []
    for times in (early, late):
        slave.prepare(times)
        width = np.diff(times)[:, None]
        terms = np.array([slave.announced[:-1, j] * width**j / factorial(j) for j in range(10)])
        # at corners terms of accelerations are larger than their sum, and so is its rounding
        largest = abs(terms).sum(axis=0).max(axis=0)
        errors.append((abs(terms.sum(axis=0) - slave.ended[1:, 0]) / largest).max())
    assert abs(np.diff(late) - np.diff(early)).max() > 4e-13
    assert max(errors) < 32 * np.finfo(float).eps


MakeTask = Callable[..., Path]
GAINS = {"proportional": 1e4, "integral": 1e5, "derivative": 100.0}
FREE = ('canHandleVariableCommunicationStepSize="false"', 'canHandleVariableCommunicationStepSize="true"')
NO_STEP = ('<DefaultExperiment stepSize="1e-3"/>', "")
SIGNALS = ("joint1.torque", "joint2.torque", "joint1.position", "joint2.position")


@pytest.fixture(scope="module")
def robot() -> Scene:
    """The paper's robot, driven by torques, with steps and breakpoints that aren't the controller's."""
    changes = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "trajectory.dwell": 0.0}
    return load_scene("barnard2012-6kg").replace(changes | {"cosimulation.step": 4e-4, "trajectory.duration": 0.2171})


def with_task(robot: Scene, path: Path, **keys: Any) -> Scene:
    """The robot with the FMU as its controller."""
    parameters = GAINS | keys.pop("parameters", {})
    return robot.replace({"controller": [{"kind": "fmu", "path": str(path), "parameters": parameters, **keys}]})


def agree(found: Run, twin: Run) -> None:
    """All signals of both runs, to 1e-12 of their magnitude."""
    assert found.completed, found.message
    np.testing.assert_array_equal(found.recording.time, twin.recording.time)
    for name in SIGNALS:
        exact = twin.recording[name].values
        np.testing.assert_allclose(found.recording[name].values, exact, rtol=0.0, atol=1e-12 * abs(exact).max())


@pytest.mark.parametrize(
    "keys", [{}, {"offset": 4e-4}, {"parameters": {"direct": True}}, None], ids=["task", "offset", "direct", "default"]
)
def test_a_fixed_step_controller_equals_its_python_twin(
    robot: Scene, make_task: MakeTask, keys: dict[str, Any] | None
) -> None:
    """Whether it calculates in its step or puts out at once: sampled at its own instants, equal steps, none late. An FMU
    that can't vary its step takes the sample time from its default experiment; from Python by its path alone."""
    if keys is None:
        found = flexfmu.run(robot, controllers=[fmu_slave(make_task(), "task", GAINS)])
    else:
        found = run_scene(with_task(robot, make_task(), sample_time=1e-3, name="task", **keys))
    offset = (keys or {}).get("offset", 0.0)
    agree(found, flexfmu.run(robot, controllers=[pid(*GAINS.values(), sample_time=1e-3, offset=offset)]))
    assert {each.seconds for each in found.delays} == {0.0}
    assert {each.name: each.sample_time for each in found.slaves}["task"] == 1e-3


def test_ssp_keeps_the_sample_time(robot: Scene, make_task: MakeTask, tmp_path: Path) -> None:
    """An annotation states it where the FMU doesn't; read back, the file runs as the scene does."""
    scene = with_task(robot, make_task(FREE, NO_STEP), sample_time=1e-3, offset=4e-4, name="task")
    run, loaded = run_scene(scene), load_ssp(export_ssp(scene, tmp_path / "task.ssp"))
    torque = loaded.simulate().recording["task.joint1.torque"].values
    exact = run.recording["joint1.torque"].values
    np.testing.assert_allclose(torque, exact, rtol=0.0, atol=1e-11 * abs(exact).max())


@pytest.mark.parametrize("step_control", [None, StepDoubling(1e-3)])
def test_irregular_steps_are_refused(make_task: MakeTask, step_control: StepDoubling | None) -> None:
    """Without any sample time it would get steps that it can't make: the message names the key."""
    path = make_task(NO_STEP)
    task = fmu_slave(path, "task")
    assert isinstance(task, FmuSlave)
    system = connect([task], [])
    if step_control is None:
        simulate(system, 0.005, 1e-3)
    with pytest.raises(InputError, match=r"task takes equal communication steps alone .*sample_time = 0\.001"):
        simulate(system, 0.0055, 1e-3, step_control=step_control)


def test_what_is_sampled_and_how(make_task: MakeTask, foreign_fmu: Path) -> None:
    """By behaviour and description: outputs that follow inputs at once or depend on none are there before the step."""
    assert isinstance(fmu_slave(make_task()), FmuTask)
    assert isinstance(fmu_slave(make_task(), parameters={**GAINS, "direct": True}), SampledFmu)
    assert isinstance(fmu_slave(make_task(FREE)), FmuSlave)
    assert isinstance(fmu_slave(foreign_fmu), FmuSlave)
    assert isinstance(fmu_slave(foreign_fmu, sample_time=0.1), SampledFmu)


def test_a_state_is_sampled_before_its_step(foreign_fmu: Path) -> None:
    """x' = -x holds exp(-k h) from its k-th instant on, not the value one step ahead."""
    slave = fmu_slave(foreign_fmu, "decay", sample_time=0.1, offset=0.05)
    recording = simulate(connect([slave], []), 1.0, 0.05).recording
    number = np.maximum(np.floor((recording.time - 0.05) / 0.1 + 1e-9), 0.0)
    last = np.append(np.diff(recording.time) > 0.0, True)  # right limits
    np.testing.assert_allclose(recording["decay.x"].values[last], np.exp(-0.1 * number[last]), rtol=1e-12)
