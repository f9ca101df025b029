"""Going back with FMUs: to the last bit with ours, refused by name with one that can't."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.couplings import Implicit, Jacobi
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import System, connect
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.model.scene.file import load_scene

POSITION = ("plant.end_effector.position.x", "plant.end_effector.position.y")


@pytest.fixture(scope="module")
def plant() -> FmuSlave:
    """The paper's robot with 0.1 kg."""
    return FmuSlave(build_scene(load_scene("barnard2012-0.1kg")).path, "plant")


def driven(order: int) -> System:
    """The robot on its trajectory, which is sent with that many derivatives."""
    scene = load_scene("barnard2012-0.1kg")
    robot = FmuSlave(build_scene(scene).path, "plant", input_order=order)
    references = TrajectorySlave(plan(scene).joints, order=order)
    wires = [(f"trajectory.{each.name}", f"plant.{each.name}") for each in references.variables]
    return connect([references, robot], wires)


def test_an_fmu_goes_back_exactly(plant: FmuSlave) -> None:
    """Saved, moved on and restored, again and again: the same numbers to the last bit, in the memory of one state."""
    plant.initialize(0.0, 1.0, 1e-6)
    assert plant.can_save
    outputs = np.array([i for i, each in enumerate(plant.variables) if each.causality == "output"])
    inputs = np.array([i for i, each in enumerate(plant.variables) if each.name == "joint1.reference.acceleration"])
    plant.set(inputs, np.array([3.0]))
    plant.step(0.0, 1e-3)
    states, found = set(), []
    for _ in range(3):
        state = plant.save()
        states.add(id(state))
        here = []
        for tries in range(2):
            if tries:
                plant.restore(state)
            plant.step(1e-3, 5e-3)
            values = np.empty(outputs.size)
            plant.get(outputs, values)
            here.append(values)
        np.testing.assert_array_equal(*here)
        found.append(here[0])
        plant.restore(state)
        plant.release(state)
    np.testing.assert_array_equal(found[0], found[2])
    assert len(states) == 1
    plant.terminate()


def test_second_derivatives_follow_saved_first_ones(plant: FmuSlave) -> None:
    """A state saved between the first and the second derivatives of the outputs has all that the second ones need."""
    plant.initialize(0.0, 1.0, 1e-6)
    outputs = np.array([i for i, each in enumerate(plant.variables) if each.causality == "output"])
    inputs = np.array([i for i, each in enumerate(plant.variables) if each.name == "joint1.reference.acceleration"])
    plant.set(inputs, np.array([30.0]))
    plant.step(0.0, 1e-3)
    before = plant.save()
    first, expected, elsewhere, found = (np.empty((order, outputs.size)) for order in (1, 2, 2, 2))
    plant.get_derivatives(outputs, expected)
    plant.restore(before)
    plant.get_derivatives(outputs, first)
    between = plant.save()
    plant.step(1e-3, 5e-2)
    plant.get_derivatives(outputs, elsewhere)
    plant.restore(between)
    plant.get_derivatives(outputs, found)
    np.testing.assert_array_equal(found, expected)
    assert not np.array_equal(elsewhere, expected)
    for state in (before, between):
        plant.release(state)
    plant.terminate()


def test_the_algorithm_does_not_matter_without_a_loop() -> None:
    """A trajectory that is known in advance drives the robot alike, whatever the algorithm; nothing is delayed."""
    reference = simulate(driven(9), 0.05, 1e-3)
    for algorithm in (Jacobi(), Implicit()):
        result = simulate(driven(9), 0.05, 1e-3, algorithm=algorithm)
        for name in POSITION:
            np.testing.assert_array_equal(result.recording[name].values, reference.recording[name].values)
        assert {each.seconds for each in result.delays} == {0.0}


def test_an_fmu_that_cannot_go_back_is_refused(foreign_fmu: Path) -> None:
    """An FMU without saved states is named before the run; side by side it runs without."""
    slaves = [FmuSlave(foreign_fmu, name) for name in ("first", "second")]
    wires = [("first.x", "second.u"), ("second.x", "first.u")]
    for kind in ({"step_control": StepDoubling()}, {"algorithm": Implicit()}):
        with pytest.raises(InputError, match=r"can't save and restore its state.*canGetAndSetFMUstate"):
            simulate(connect(slaves, wires), 1.0, 0.1, **kind)
    result = simulate(connect(slaves, wires), 1.0, 0.1, algorithm=Jacobi())
    # x' = u - x with u held: both stay where they are, as x = u = 1
    np.testing.assert_allclose(result.recording["first.x"].values, 1.0)
    assert [each.seconds for each in result.delays] == pytest.approx([0.1, 0.1])
