"""FMUs as slaves: any FMI 2.0 co-simulation FMU runs, and a failing one says why in its own words; going back is exact with ours, and refused
by name with one that can't."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from ctypes import POINTER, c_int32, c_uint32, c_void_p, cast
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.calls import FMI2, MAXIMUM_COMPLAINTS, MAXIMUM_MESSAGES, WARNING, FmuLog
from flexfmu.cosim.engine.fmu.clocks import Clocks
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.transfers import Transfers
from flexfmu.cosim.engine.fmu.variables import Handle
from flexfmu.cosim.engine.master.couplings import Implicit, Jacobi
from flexfmu.cosim.engine.master.simulator import Outcome, Simulation, simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import System, connect
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.model.scene.file import load_scene

Make = Callable[..., Path]


def run(path: Path, **parameters: float | str) -> tuple[FmuSlave, Simulation]:
    """One second of the FMU alone."""
    slave = FmuSlave(path, "decay", parameters)
    return slave, simulate(connect([slave], []), stop=1.0, step=0.1)


def living_instances(slave: FmuSlave) -> int:
    """How many instances of the foreign FMU exist."""
    return ctypes.c_int.in_dll(ctypes.CDLL(str(next(slave._fmu.folder.glob("binaries/*/*")))), "decay_instances").value


def test_a_foreign_fmu_runs(foreign_fmu: Path) -> None:
    """An FMU without any optional capability gives the closed form, its integers and its units."""
    slave, result = run(foreign_fmu, rate=2.0)
    assert result.outcome is Outcome.COMPLETED
    np.testing.assert_allclose(result.recording["decay.x"].values, np.exp(-2.0 * result.recording.time), rtol=1e-14)
    np.testing.assert_array_equal(result.recording["decay.steps"].values, np.arange(11.0))
    assert {each.name: each.discrete for each in slave.variables if each.causality == "output"} == {
        "x": False,
        "steps": True,
    }
    assert result.recording["decay.x"].unit == "m"
    assert result.recording["decay.x"].first is None
    assert slave.statistics == {"steps": 10}
    assert living_instances(slave) == 0


def test_several_instances_at_once(foreign_fmu: Path) -> None:
    """Two instances of one FMU don't share state, and one drives the other through reals and booleans alike."""
    first, second = FmuSlave(foreign_fmu, "first", {"rate": 3.0}), FmuSlave(foreign_fmu, "second", {"inverted": True})
    result = simulate(connect([first, second], [("first.x", "second.u")]), stop=1.0, step=0.5)
    held = [math.exp(-3.0 * 0.5 * n) for n in range(2)]
    x = 1.0
    for u in held:
        x = -u + (x + u) * math.exp(-0.5)
    assert result.recording["second.x"].values[-1] == pytest.approx(x, rel=1e-14)


@pytest.mark.parametrize(
    ("given", "outcome", "message"),
    [
        ({"trouble": "fails", "label": "Bob"}, Outcome.STEP_FAILED, "Bob is tired after 5 steps"),
        ({"trouble": "discards"}, Outcome.STEP_FAILED, "(fmi2Discard), take a smaller communication step"),
        ({"rate": -1.0}, Outcome.INITIALISATION_FAILED, "decay is tired after 0 steps"),
    ],
)
def test_a_failing_fmu_speaks_for_itself(
    foreign_fmu: Path, given: dict[str, Any], outcome: Outcome, message: str
) -> None:
    """The error carries the FMU's sentence, formatted with its arguments, or how far it came with a step that it discards; results
    up to there are kept, and the FMU is freed."""
    slave, result = run(foreign_fmu, **given)
    assert result.outcome is outcome
    time = "0.5" if outcome is Outcome.STEP_FAILED else "0"
    assert result.message.startswith(f"decay failed at {time} s: ")
    assert result.message.endswith(message)
    np.testing.assert_allclose(result.recording.time, np.arange(6 if time == "0.5" else 0) * 0.1)
    assert slave.messages == (() if "discards" in given.values() else (message,))
    assert living_instances(slave) == 0


def test_dropped_slaves_leave_no_instance(foreign_fmu: Path) -> None:
    """A slave that nobody terminates is freed with its object."""
    slave, other = FmuSlave(foreign_fmu), FmuSlave(foreign_fmu)
    slave.initialize(0.0, 1.0, None)
    assert living_instances(other) == 1
    del slave
    assert living_instances(other) == 0


def test_ranges_are_those_of_the_description(make_decay: Make) -> None:
    """A range may be one-sided and may stand in the variable's type; the limits themselves are inside."""
    length = ('<Real start="1"/>', '<Real declaredType="Length" start="1"/>')
    ranged = make_decay(length, ('<Real unit="m"/>', '<Real unit="m" min="0.5"/>'))
    assert FmuSlave(ranged, parameters={"rate": 0.5}).name == "fmu"
    with pytest.raises(InputError, match=r"rate must be at least 0\.5 m, got 0\.4 m$"):
        FmuSlave(ranged, parameters={"rate": 0.4})


ANNOTATION = '<VendorAnnotations><Tool name="flexfmu"><InputDerivatives maxOrder="{}"/></Tool></VendorAnnotations>'


@pytest.mark.parametrize(
    ("capability", "annotation", "order"),
    [
        ("", "", 0),
        ('canInterpolateInputs="true"', "", 1),
        ('canInterpolateInputs="true"', ANNOTATION.format(7), 7),
        ("", ANNOTATION.format(7), 0),
    ],
)
def test_highest_input_derivative_is_the_stated_one(
    foreign_fmu: Path, make_decay: Make, capability: str, annotation: str, order: int
) -> None:
    """An FMU gets the input derivatives that its description states: none, FMI's first one, or the annotated order."""
    able = ("<CoSimulation ", f"<CoSimulation {capability} ")
    annotated = make_decay(able, ("<ModelVariables>", f"{annotation}<ModelVariables>"))
    assert FmuSlave(annotated).max_input_order == order
    # and it doesn't get any that it can't take
    if order == 0:
        source, target = FmuSlave(foreign_fmu, "source"), FmuSlave(annotated, "target")
        assert simulate(connect([source, target], [("source.x", "target.u")]), 1.0, 0.5).outcome is Outcome.COMPLETED


def test_integers_are_rounded() -> None:
    """What comes out of a calculation is nearly a whole number, and the nearest one is meant."""
    told: list[tuple[int, int]] = []

    def set_integer(component: c_void_p, references: int, count: int, values: int) -> int:
        names, numbers = cast(references, POINTER(c_uint32)), cast(values, POINTER(c_int32))
        told.extend((names[i], numbers[i]) for i in range(count))
        return 0

    instance: Any = SimpleNamespace(
        calls={"fmi2SetInteger": set_integer},
        component=c_void_p(1),
        version=FMI2,
        name="fmu",
        exchange=None,
        clocks=Clocks(None),
    )
    transfers = Transfers(instance)
    handles = [Handle("Integer", 7, "Integer"), Handle("Integer", 9, "Integer")]
    assert transfers.set(handles, np.array([2.9999999999, -1.0000000001]))() == 0
    assert told == [(7, 3), (9, -1)]


def test_a_chatty_fmu_does_not_fill_the_memory() -> None:
    """The first messages and the last complaints are kept."""
    log = FmuLog()
    try:
        for i in range(1000):
            log.add(WARNING + 1, f"step  {i}\nfailed")
    finally:
        log.close()
    assert len(log.messages) == MAXIMUM_MESSAGES < 1000
    assert log.messages[0] == "step 0 failed"
    assert log.complaint() == "; ".join(f"step {i} failed" for i in range(1000 - MAXIMUM_COMPLAINTS, 1000))


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
