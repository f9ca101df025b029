"""In the master an exported block or trajectory does what its Python twin does, and is sampled by the loop in C with the bits of the loop in
Python."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi
import numpy as np
import pytest
from export_support.blocks import SAMPLE_TIME, block, delay, pd_controller
from export_support.kinds import KINDS, signals_of, source
from export_support.trajectories import lame
from python_slave import PythonSlave
from scipy.linalg import expm

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.engine.fmu.sampled_slave import FmuTask, SampledFmu, fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import Outcome, Simulation, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.engine.slave import Indices, RealArray, Slave, SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import FmuTrajectory, TrajectorySlave
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.trajectory_build import Motion
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.profiles import bang_bang


class Mass(PythonSlave):
    """A mass on a spring, pushed by a held force: x'' = force - 900 x, solved exactly."""

    name = "mass"
    feedthrough = {"x": ()}  # noqa: RUF012
    variables = (SlaveVariable("x", "output", "1"), SlaveVariable("force", "input", "1", 0.0))

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.state = np.array([0.1, 0.0])
        self.memory[:] = 0.1, 0.0

    def step(self, time: float, step: float) -> None:
        rest = np.array([self.memory[1] / 900.0, 0.0])
        self.state = rest + expm(step * np.array([[0.0, 1.0], [-900.0, 0.0]])) @ (self.state - rest)
        self.memory[0] = self.state[0]


def closed_loop(controller: Any, step: float, measurement: str = "in2") -> dict[str, RealArray]:
    """Recording of the mass under a controller of its position, reference zero, over 30 samples."""
    wires = [("mass.x", f"{controller.name}.{measurement}"), (f"{controller.name}.out1", "mass.force")]
    system = connect([Mass(), controller], wires)
    simulation = simulate(system, 30 * SAMPLE_TIME, step)
    assert simulation.outcome is Outcome.COMPLETED, simulation.message
    recording = simulation.recording
    return {name: np.array(recording[name].values) for name in ("mass.x", f"{controller.name}.out1")}


MADE = {
    "controller": pd_controller(),
    "late controller": replace(pd_controller(), offset=0.35 * SAMPLE_TIME),
    "delay, no algebraic loop": replace(delay(3), feedthrough={"out1": ()}),
}


@pytest.mark.parametrize("name", MADE)
@pytest.mark.parametrize("ratio", [1.0, 0.25, 3.0, 0.3])
def test_exported_controller_equals_its_twin(ratio: float, name: str) -> None:
    """Sampled at the same instants, in the same order, with the same inputs: whatever the communication step."""
    block = MADE[name]
    slaves = BlockSlave(block, "controller"), SampledFmu(build_fmu(block).path, "controller")
    assert dict(slaves[0].feedthrough) == dict(slaves[1].feedthrough)
    twin, found = (closed_loop(slave, ratio * SAMPLE_TIME, block.inputs[-1].name) for slave in slaves)
    for signal, values in twin.items():
        np.testing.assert_allclose(found[signal], values, rtol=0.0, atol=1e-12 * max(1.0, abs(values).max()))
    assert abs(twin["controller.out1"]).max() > 0.4, "the controller does something"


def test_saves_and_restores() -> None:
    """A master that repeats steps gets the same samples."""
    slave = SampledFmu(build_fmu(pd_controller()).path)
    (output,) = (i for i, each in enumerate(slave.variables) if each.causality == "output")
    values = np.empty(1)

    def sample(k: int, u: float) -> float:
        slave.set(np.array([0, 1]), np.array([u, 0.0]))
        slave.sample(k * SAMPLE_TIME)
        slave.get(np.array([output]), values)
        return float(values[0])

    slave.initialize(0.0, 1.0, None)
    sample(0, 1.0)
    state = slave.save()
    first = [sample(1, 2.0), sample(2, 3.0)]
    slave.restore(state)
    assert [sample(1, 2.0), sample(2, 3.0)] == first
    slave.terminate()


def test_trajectory_streams_as_its_twin() -> None:
    """References, derivatives and breakpoints that a plant is fed with, from the FMU and from Python."""
    trajectory = lame(bang_bang())
    exported = FmuTrajectory(build_fmu(Motion(trajectory)).path)
    assert exported.breakpoints == trajectory.breakpoints
    recordings = [
        simulate(connect([TrajectorySlave(each)], []), 1.1 * trajectory.duration, 1e-3).recording
        for each in (trajectory, exported)
    ]
    np.testing.assert_array_equal(recordings[0].time, recordings[1].time)
    for kind in ("position", "velocity", "acceleration"):
        for axis in (1, 2):
            twin, found = (each[f"trajectory.joint{axis}.reference.{kind}"] for each in recordings)
            np.testing.assert_allclose(found.values, twin.values, rtol=0.0, atol=1e-12 * abs(twin.values).max())
            assert twin.first is not None
            assert found.first is not None
            np.testing.assert_allclose(found.first, twin.first, rtol=0.0, atol=1e-10 * abs(twin.first).max())
    # derivatives up to the sixth of the motion; the higher, the less exact
    times = np.random.default_rng(5).uniform(0.0, trajectory.duration, 200)
    exact, again = (each.evaluate(times, 6) for each in (trajectory, exported))
    errors = abs(again - exact).max(axis=(1, 2)) / abs(exact).max(axis=(1, 2))
    assert (errors < [1e-12, 1e-12, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4]).all(), errors
    with pytest.raises(InputError, match="orders 0 to 6, got order 7"):
        exported.evaluate(0.1, 7)


def test_other_fmus_are_refused() -> None:
    """A trajectory has no sample time, a controller no breakpoints."""
    controller, trajectory = build_fmu(pd_controller()).path, build_fmu(Motion(lame(bang_bang()))).path
    assert isinstance(fmu_slave(controller), SampledFmu)
    assert isinstance(fmu_slave(trajectory), FmuSlave)
    with pytest.raises(FmuFileError, match="doesn't tell its sample time"):
        SampledFmu(trajectory)
    with pytest.raises(FmuFileError, match="doesn't tell its breakpoints"):
        FmuTrajectory(controller)


COUNT = 200
"""Samples of a run: all stages of the source, and more than the memory of what delays."""


class Clock(PythonSlave):
    """y = (t, sin t), stepped in Python."""

    name = "clock"
    variables = (SlaveVariable("t", "output"), SlaveVariable("sine", "output"))

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = np.array([self.time, np.sin(self.time)])[indices]


class Counted:
    """Counts the samples that Python takes of a slave."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *kinds: type) -> None:
        self.calls = 0
        for kind in kinds:
            for phase in {"sample", "output", "update"} & set(vars(kind)):
                monkeypatch.setattr(kind, phase, self._counting(getattr(kind, phase)))

    def _counting(self, method: Callable[[Any, float], None]) -> Callable[[Any, float], None]:
        def counted(slave: Any, time: float) -> None:
            self.calls += 1
            method(slave, time)

        return counted


def fed(slaves: list[Any]) -> Any:
    """The slaves' inputs fed by the source as in `motion`, beside a slave in Python."""
    signals = [
        (f"source.signal{i}", f"{slave.name}.{each.name}")
        for slave in slaves
        for i, each in zip(signals_of(slave.block), slave.block.inputs, strict=True)
    ]
    return connect([BlockSlave(source()), Clock(), *slaves], signals)


def runs(system: Any, record: Selection = EVERYTHING) -> tuple[Simulation, Simulation]:
    """In C and in Python; the communication step isn't the sample time."""
    return tuple(  # type: ignore[return-value]
        simulate(system, COUNT * SAMPLE_TIME, 0.4 * SAMPLE_TIME, compiled=each, record=record) for each in (True, False)
    )


def assert_same_bits(found: Simulation, exact: Simulation) -> None:
    """All signals, zeros with their signs."""
    assert (found.outcome, found.message, found.steps) == (exact.outcome, exact.message, exact.steps)
    assert found.recording.time.tobytes() == exact.recording.time.tobytes()
    assert list(found.recording.columns) == list(exact.recording.columns)
    for name, column in found.recording.columns.items():
        assert column.values.tobytes() == exact.recording[name].values.tobytes(), name


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_at_several_rates(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A block, and the same one slower and later, beside a slave in Python: Python takes the first samples alone."""
    made = KINDS[name]()
    slower = replace(made, name="slower", sample_time=2.0 * SAMPLE_TIME, offset=0.5 * SAMPLE_TIME)
    slaves = [BlockSlave(made), BlockSlave(slower)]
    found, exact = runs(fed(slaves))
    assert found.outcome is Outcome.COMPLETED
    assert_same_bits(found, exact)
    outputs = np.array([found.recording[f"{made.name}.{each.name}"].values for each in made.outputs])
    assert np.ptp(outputs) > 0.0
    # a third run counts
    counted = Counted(monkeypatch, BlockSlave)
    simulate(fed(slaves), COUNT * SAMPLE_TIME, 0.4 * SAMPLE_TIME, compiled=True)
    assert 0 < counted.calls <= 2 * 3, "the first instant"


class WithBlock(SampledFmu):
    """A sampled FMU that knows its block, for `fed`."""

    def __init__(self, exported: SymbolicBlock, *arguments: Any) -> None:
        self.block = exported
        super().__init__(build_fmu(exported).path, exported.name, *arguments)


class Task(FmuTask):
    """An exported block that is sampled in its step."""

    def __init__(self, exported: SymbolicBlock, offset: float) -> None:
        self.block = exported
        slave = FmuSlave(build_fmu(exported).path, exported.name, input_order=0, output_order=0)
        super().__init__(slave, 2.0 * SAMPLE_TIME, offset)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        lambda: WithBlock(KINDS["pid"]()),
        lambda: WithBlock(replace(KINDS["pid"](), sample_time=2.0 * SAMPLE_TIME, offset=0.5 * SAMPLE_TIME)),
        lambda: WithBlock(KINDS["pid"](), None, (2.0 * SAMPLE_TIME, 0.5 * SAMPLE_TIME)),
        lambda: Task(KINDS["pid"](), 0.0),
        lambda: Task(KINDS["pid"](), 0.5 * SAMPLE_TIME),
    ],
    ids=["block", "later", "equal steps", "task", "later task"],
)
def test_sampled_fmus(make: Callable[[], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Stepped, set and read at the same instants with the same numbers."""
    slave = make()
    found, exact = runs(fed([slave]))
    assert found.outcome is Outcome.COMPLETED
    assert np.ptp(found.recording[f"{slave.name}.joint1.torque"].values) > 0.0
    assert_same_bits(found, exact)
    counted = Counted(monkeypatch, SampledFmu, FmuTask)
    simulate(fed([slave]), COUNT * SAMPLE_TIME, 0.4 * SAMPLE_TIME, compiled=True)
    assert counted.calls <= 3, "the first instant"


def test_an_fmu_that_fails_at_a_sample() -> None:
    """The sentence, its instant and the recording up to there."""
    system = fed([WithBlock(raising(lambda u: casadi.sqrt(0.5 - u)))])
    found, exact = runs(system)
    assert found.outcome is Outcome.STEP_FAILED
    assert_same_bits(found, exact)


def raising(equation: Callable[[Any], Any], kind: Any = casadi.SX) -> SymbolicBlock:
    """A block of one input and one output."""
    return block("block", [], 1, lambda x, u, p: [equation(u)], lambda x, u, p: [], kind=kind)


class Doubled(casadi.Callback):  # type: ignore[misc]
    """2 u, in Python."""

    def __init__(self) -> None:
        casadi.Callback.__init__(self)
        self.construct("doubled", {})

    def eval(self, arguments: list[Any]) -> list[Any]:
        return [2.0 * arguments[0]]


def test_equations_that_take_python() -> None:
    """A callback, or an assertion that fails: sampled in Python, in the loop in C too."""
    doubled = Doubled()
    found, exact = runs(fed([BlockSlave(raising(doubled, casadi.MX))]))
    assert found.outcome is Outcome.COMPLETED
    assert_same_bits(found, exact)
    assert found.recording["block.out1"].values[-1] == 2.0 * found.recording["source.signal0"].values[-1]
    found, exact = runs(fed([BlockSlave(raising(lambda u: u.attachAssert(u < 0.5, "too large"), casadi.MX))]))
    assert found.outcome is Outcome.STEP_FAILED
    assert "too large" in found.message
    assert_same_bits(found, exact)


def ring(exported: tuple[int, ...]) -> Any:
    """Five discrete systems with and without direct feedthrough, of several rates and offsets; some of them as FMUs."""
    rng = np.random.default_rng(3)
    slaves: list[Slave] = [Clock()]
    for i in range(5):
        a, b, c = 0.4 * rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(2, 3))
        d = float(rng.normal())
        system = block(
            f"s{i}",
            [0.1, 0.2, 0.3],
            2,
            lambda x, u, p, c=c, d=d: [c @ x + casadi.vertcat(0.0, d * u[1])],
            lambda x, u, p, a=a, b=b: [a @ x + b @ u],
            sample_time=int(rng.integers(1, 4)) * SAMPLE_TIME,
            offset=0.5 * int(rng.integers(0, 2)) * SAMPLE_TIME,
        )
        slaves.append(WithBlock(system) if i in exported else BlockSlave(system))
    signals = [(f"s{i}.out1", f"s{(i + 1) % 5}.in2") for i in range(5)]
    return connect(slaves, [*signals, *(("clock.sine", f"s{i}.in1") for i in range(5))])


def test_a_ring_of_random_systems() -> None:
    """Inputs change between the output and the update of a sample, of blocks and of FMUs, which agree."""
    blocks, exact = runs(ring(()))
    assert blocks.outcome is Outcome.COMPLETED, blocks.message
    assert_same_bits(blocks, exact)
    found, exact = runs(ring((1, 4)))
    assert_same_bits(found, exact)
    for name, column in blocks.recording.columns.items():
        np.testing.assert_allclose(found.recording[name].values, column.values, rtol=0.0, atol=1e-11)
    assert np.ptp(blocks.recording["s4.out2"].values) > 1.0
