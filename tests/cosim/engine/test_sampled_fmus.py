"""FMUs of other tools, stepped at their own instants: a fixed-step PID that calculates in fmi2DoStep, and plain ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import pid

import flexfmu
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.sampled_slave import FmuTask, SampledFmu, fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.exchange.ssp.export import export_ssp
from flexfmu.cosim.exchange.ssp.loading import load_ssp
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

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
