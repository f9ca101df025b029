"""In the master an exported block or trajectory does what its Python twin does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from export_support.blocks import SAMPLE_TIME, delay, pd_controller
from export_support.trajectories import lame
from python_slave import PythonSlave
from scipy.linalg import expm

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.engine.fmu.sampled_slave import SampledFmu, fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import RealArray, SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import FmuTrajectory, TrajectorySlave
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.trajectory_build import Motion
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
