"""In the master an exported block or trajectory does what its Python twin does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
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


def closed_loop(controller: Any, step: float) -> dict[str, RealArray]:
    """Recording of the mass under a controller of its position, reference zero, over 30 samples."""
    system = connect(
        [Mass(), controller], [("mass.x", f"{controller.name}.in2"), (f"{controller.name}.out1", "mass.force")]
    )
    simulation = simulate(system, 30 * SAMPLE_TIME, step)
    assert simulation.outcome is Outcome.COMPLETED, simulation.message
    recording = simulation.recording
    return {name: np.array(recording[name].values) for name in ("mass.x", f"{controller.name}.out1")}


@pytest.mark.parametrize("offset", [0.0, 0.35])
@pytest.mark.parametrize("ratio", [1.0, 0.25, 3.0, 0.3])
def test_exported_controller_equals_its_twin(ratio: float, offset: float) -> None:
    """Sampled at the same instants, in the same order, with the same inputs: whatever the communication step."""
    block = replace(pd_controller(), offset=offset * SAMPLE_TIME)
    twin = closed_loop(BlockSlave(block, "controller"), ratio * SAMPLE_TIME)
    found = closed_loop(SampledFmu(build_fmu(block).path, "controller"), ratio * SAMPLE_TIME)
    for name, values in twin.items():
        np.testing.assert_allclose(found[name], values, rtol=0.0, atol=1e-12 * max(1.0, abs(values).max()))
    assert abs(twin["controller.out1"]).max() > 0.5, "the controller does something"


def test_controller_without_feedthrough(tmp_path: Path) -> None:
    """A pure delay in a loop isn't algebraic, as its description says."""
    block = replace(delay(3), feedthrough={"out1": ()})
    fmu = SampledFmu(build_fmu(block).path, "delay")
    twin = BlockSlave(block, "delay")
    assert dict(fmu.feedthrough) == dict(twin.feedthrough)
    found, exact = (_delayed(slave) for slave in (fmu, twin))
    np.testing.assert_array_equal(found, exact)


def _delayed(slave: Any) -> RealArray:
    system = connect([Mass(), slave], [("mass.x", "delay.in1"), ("delay.out1", "mass.force")])
    return np.array(simulate(system, 0.05, 4e-4).recording["mass.x"].values)


def test_parameters_reach_the_fmu() -> None:
    """Gains are given when the slave is made, by name."""
    path = build_fmu(pd_controller()).path
    weak = closed_loop(SampledFmu(path, "controller", {"kp": 0.0, "kd": 0.0}), SAMPLE_TIME)
    assert (weak["controller.out1"] == 0.0).all()
    with pytest.raises(InputError, match="no parameter 'gain'"):
        SampledFmu(path, "controller", {"gain": 1.0})


def test_saves_and_restores() -> None:
    """A master that repeats steps gets the same samples."""
    slave = SampledFmu(build_fmu(pd_controller()).path)
    indices, values = np.array([0, 1]), np.empty(1)
    output = np.array([i for i, each in enumerate(slave.variables) if each.causality == "output"])

    def sample(k: int, u: float) -> float:
        slave.set(indices, np.array([u, 0.0]))
        slave.sample(k * SAMPLE_TIME)
        slave.get(output, values)
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
    with pytest.raises(InputError, match="orders 0 to 6, got order 7"):
        exported.evaluate(0.1, 7)


def test_higher_derivatives_come_along() -> None:
    """A master streams polynomials with derivatives up to the sixth of the motion; the higher, the less exact."""
    trajectory = lame(bang_bang())
    exported = FmuTrajectory(build_fmu(Motion(trajectory)).path)
    times = np.random.default_rng(5).uniform(0.0, trajectory.duration, 200)
    exact, found = (each.evaluate(times, 6) for each in (trajectory, exported))
    errors = abs(found - exact).max(axis=(1, 2)) / abs(exact).max(axis=(1, 2))
    assert (errors < [1e-12, 1e-12, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4]).all(), errors


def test_other_fmus_are_refused() -> None:
    """A trajectory has no sample time, a controller no breakpoints."""
    controller, trajectory = build_fmu(pd_controller()).path, build_fmu(Motion(lame(bang_bang()))).path
    assert isinstance(fmu_slave(controller), SampledFmu)
    assert isinstance(fmu_slave(trajectory), FmuSlave)
    with pytest.raises(FmuFileError, match="doesn't tell its sample time"):
        SampledFmu(trajectory)
    with pytest.raises(FmuFileError, match="doesn't tell its breakpoints"):
        FmuTrajectory(controller)
