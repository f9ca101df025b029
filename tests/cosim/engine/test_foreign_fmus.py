"""What FMUs of other tools do otherwise than they state, or rarely do though it is legal."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from python_slave import PythonSlave

from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT
from flexfmu.cosim.engine.errors import FmuFileError, SlaveWarning, WiringError
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import Outcome, Simulation, simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import Recording, Selection
from flexfmu.cosim.engine.slave import TEXTS as CODES
from flexfmu.cosim.engine.slave import SlaveVariable

Make = Callable[..., Path]

Y = '<ScalarVariable name="y" valueReference="3" causality="output"><Real unit="m"/></ScalarVariable>'
TEXTS = (
    '<ScalarVariable name="word" valueReference="0" causality="input" variability="discrete"><String start="decay"/>'
    '</ScalarVariable><ScalarVariable name="said" valueReference="1" causality="output" variability="discrete">'
    "<String/></ScalarVariable>"
)
TWO_OUTPUTS = "</ModelVariables>", Y + "</ModelVariables>"
STATES_DERIVATIVES = "<CoSimulation ", '<CoSimulation maxOutputDerivativeOrder="1" canInterpolateInputs="true" '
ISOLATED = pytest.param(CALL_LIMIT, marks=pytest.mark.skipif(not AVAILABLE, reason="isolation needs Linux"))


def alone(slave: Any, isolation: float | None = None, **more: Any) -> Simulation:
    """One second."""
    return simulate(connect([slave], []), 1.0, 0.1, isolation=isolation, **more)


def remarks(action: Callable[[], Any]) -> tuple[Any, list[str]]:
    """What comes of it, and the warnings about slaves."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = action()
    return result, [str(each.message) for each in caught if issubclass(each.category, SlaveWarning)]


@pytest.mark.parametrize("isolation", [None, ISOLATED])
@pytest.mark.parametrize(
    ("trouble", "absent"),
    [("none", ()), ("nan first", ("x", "y")), ("nan always", ("x", "y")), ("nan later", ("y",)), ("refuses", ("y",))],
)
def test_derivatives_that_are_not_there(
    make_decay: Make, trouble: str, absent: Sequence[str], isolation: float | None
) -> None:
    """Derivatives that are stated and are NaN, or refused, are left out of the results, output by output, with one
    warning; those of other outputs and all values are right."""
    slave = FmuSlave(make_decay(TWO_OUTPUTS, STATES_DERIVATIVES), "decay", {"trouble": trouble})
    result, told = remarks(lambda: alone(slave, isolation))
    assert result.outcome is Outcome.COMPLETED, result.message
    exact = np.exp(-result.recording.time)
    for name, factor in (("x", 1.0), ("y", 2.0)):
        column = result.recording[f"decay.{name}"]
        np.testing.assert_allclose(column.values, factor * exact, rtol=1e-14)
        if name in absent:
            assert column.first is None
        else:
            np.testing.assert_allclose(column.first, -factor * exact, rtol=1e-14)
    assert len(told) == bool(absent)
    for name in absent:
        assert f"der({name},1)" in told[0]


def test_nobody_hears_of_derivatives_that_nobody_asks_for(make_decay: Make) -> None:
    """An output that is neither connected nor recorded isn't asked, nor any with output_order = 0."""
    path = make_decay(TWO_OUTPUTS, STATES_DERIVATIVES)
    slave = FmuSlave(path, "decay", {"trouble": "nan later"})
    result, told = remarks(lambda: alone(slave, record=Selection(["decay.x"])))
    assert result.outcome is Outcome.COMPLETED
    assert result.recording["decay.x"].first is not None
    assert not told
    held = fmu_slave(path, "decay", {"trouble": "nan always"}, output_order=0)
    result, told = remarks(lambda: alone(held))
    assert result.recording["decay.x"].first is None
    assert not told


def test_coupling_goes_without_absent_derivatives(make_decay: Make) -> None:
    """A signal without derivatives is passed on as one of an FMU that states none, beside others that have them."""
    plain, able = make_decay(TWO_OUTPUTS), make_decay(TWO_OUTPUTS, STATES_DERIVATIVES)

    def second(path: Path, **parameters: str) -> np.ndarray[Any, Any]:
        slaves = [FmuSlave(path, "first", parameters), FmuSlave(able, "second", output_order=0)]
        assert slaves[0].max_output_order == (path is able)
        result, _ = remarks(lambda: simulate(connect(slaves, [("first.y", "second.u")]), 1.0, 0.1))
        return result.recording["second.x"].values  # type: ignore[no-any-return]

    np.testing.assert_array_equal(second(able, trouble="refuses"), second(plain))


@pytest.mark.parametrize("isolation", [None, ISOLATED])
def test_forgotten_start_values_are_set_again(make_decay: Make, isolation: float | None) -> None:
    """Parameters, inputs and texts that an FMU resets when it enters initialisation mode count all the same."""
    starts = {"rate": 2.0, "u": 3.0, "label": "Bob", "trouble": "resets"}
    slave = FmuSlave(make_decay(("</ModelVariables>", TEXTS + "</ModelVariables>")), "decay", starts)
    result, told = remarks(lambda: alone(slave, isolation))
    time = result.recording.time
    np.testing.assert_allclose(result.recording["decay.x"].values, 3.0 - 2.0 * np.exp(-2.0 * time), rtol=1e-14)
    assert result.recording["decay.said"].shown()[-1] == '"Bob, 10"'
    assert not told


@pytest.mark.parametrize("value", [1, 1.0, True, "true"])
def test_booleans_in_all_spellings(foreign_fmu: Path, value: Any) -> None:
    """0, 1, true and false, as numbers, as Python has them and as FMI spells them."""
    result = alone(FmuSlave(foreign_fmu, "decay", {"inverted": value, "u": 2.0}))
    assert result.recording["decay.x"].values[-1] == pytest.approx(-2.0 + 3.0 * np.exp(-1.0), rel=1e-12)


@pytest.mark.parametrize("isolation", [None, ISOLATED])
def test_values_that_are_not_taken_are_named(foreign_fmu: Path, isolation: float | None) -> None:
    """A start value that reads back otherwise is a warning with both values, in words where they have any."""
    starts = {"trouble": "ignores", "rate": 2.0, "label": 50 * "x"}
    _, told = remarks(lambda: alone(FmuSlave(foreign_fmu, "decay", starts), isolation))
    assert [each.partition(" after")[0] for each in told] == [
        "decay: rate was set to 2, but is 1",
        f"decay: label was set to {50 * 'x'!r}, but is {31 * 'x'!r}",
    ]


def test_a_connected_input_may_differ_from_its_start(foreign_fmu: Path) -> None:
    """What an input gets from its source before initialisation is no reason for a warning."""
    slaves = [FmuSlave(foreign_fmu, "first"), FmuSlave(foreign_fmu, "second", {"u": 5.0})]
    _, told = remarks(lambda: simulate(connect(slaves, [("first.x", "second.u")]), 1.0, 0.1))
    assert not told


@pytest.mark.parametrize("isolation", [None, ISOLATED])
@pytest.mark.parametrize("compiled", [None, False])
def test_a_slave_may_end_the_simulation(foreign_fmu: Path, compiled: bool | None, isolation: float | None) -> None:
    """fmi2Discard with fmi2Terminated is a normal end: recorded to the last time that a lone FMU has reached."""
    slave = FmuSlave(foreign_fmu, "decay", {"trouble": "ends"})
    result = alone(slave, isolation, compiled=compiled)
    assert result.outcome is Outcome.ENDED_BY_SLAVE
    assert not result.outcome.is_failure
    assert result.error is None
    assert result.message.startswith("decay asked to end the simulation at 0.55 s")
    np.testing.assert_allclose(result.recording.time, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.55], atol=1e-15)
    np.testing.assert_allclose(result.recording["decay.x"].values, np.exp(-result.recording.time), rtol=1e-14)
    # with others, which are elsewhere, the results end with the last step that all have completed
    both = connect([slave, FmuSlave(foreign_fmu, "other")], [])
    pair = simulate(both, 1.0, 0.1, compiled=compiled, isolation=isolation)
    assert pair.outcome is Outcome.ENDED_BY_SLAVE
    assert pair.recording.time[-1] == 0.5


@pytest.mark.parametrize("compiled", [None, False])
def test_a_discarded_step_is_tried_again_by_step_control(make_decay: Make, compiled: bool | None) -> None:
    """After fmi2Discard an FMU can only go back to a saved state: step control does, and finds the steps that it manages."""
    path = make_decay(("<CoSimulation ", '<CoSimulation canGetAndSetFMUstate="true" '))
    stumbling, other = FmuSlave(path, "decay", {"trouble": "stumbles"}), FmuSlave(path, "other")
    system = connect([stumbling, other], [("decay.x", "other.u")])
    fixed = simulate(system, 1.0, 0.1, compiled=compiled)
    assert fixed.outcome is Outcome.STEP_FAILED
    assert fixed.message.startswith("decay failed at 0.03 s: ")
    assert fixed.message.endswith(
        "0.03 s of the step of 0.1 s are done (fmi2Discard), take step_control, which goes back and tries smaller steps"
    )
    result = simulate(system, 1.0, 0.1, compiled=compiled, step_control=StepDoubling(tolerance=0.1))
    assert result.outcome is Outcome.COMPLETED
    time = result.recording.time
    assert 0.005 < np.diff(time).max() < 0.03 + 1e-12
    np.testing.assert_allclose(result.recording["decay.x"].values, np.exp(-time), rtol=1e-13)


@pytest.mark.parametrize("compiled", [None, False])
def test_pending_steps_are_waited_for(make_decay: Make, compiled: bool | None) -> None:
    """An FMU whose fmi2DoStep returns fmi2Pending is asked until it is done."""
    path = make_decay(("<CoSimulation ", '<CoSimulation canRunAsynchronuously="true" '))
    result = alone(FmuSlave(path, "decay", {"trouble": "lingers"}), compiled=compiled)
    assert result.outcome is Outcome.COMPLETED
    np.testing.assert_allclose(result.recording["decay.x"].values, np.exp(-result.recording.time), rtol=1e-14)


@pytest.mark.parametrize("isolation", [None, ISOLATED])
@pytest.mark.parametrize("compiled", [None, False])
def test_pending_steps_that_are_not_stated(foreign_fmu: Path, compiled: bool | None, isolation: float | None) -> None:
    """fmi2Pending without canRunAsynchronuously ends the run with the reason and the remedy, in C and in Python alike."""
    result = alone(FmuSlave(foreign_fmu, "decay", {"trouble": "lingers"}), isolation, compiled=compiled)
    assert result.outcome is Outcome.STEP_FAILED
    assert "fmi2DoStep returned fmi2Pending, which takes canRunAsynchronuously = true" in result.message
    assert "no reason" not in result.message


ONCE = "<CoSimulation ", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" needsExecutionTool="true" '


def test_one_instance_per_process(make_decay: Make) -> None:
    """Two at once are refused with both names; one after the other runs."""
    path = make_decay(ONCE)
    pair = simulate(connect([FmuSlave(path, "one"), FmuSlave(path, "two")], []), 1.0, 0.1)
    assert pair.outcome is Outcome.INITIALISATION_FAILED
    assert "two failed" in pair.message
    assert "can be instantiated only once per process" in pair.message
    assert "one is its instance" in pair.message
    for name in ("one", "two"):
        assert alone(FmuSlave(path, name)).outcome is Outcome.COMPLETED


@pytest.mark.skipif(not AVAILABLE, reason="isolation needs Linux")
def test_sequential_runs_of_an_fmu_that_lives_once(make_decay: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Isolated runs have a process of their own each; in this one a second instance names what the FMU may lack."""
    monkeypatch.setenv("DECAY_ONCE", "yes")
    path = make_decay(ONCE, STATES_DERIVATIVES, ('guid="decay"', 'guid="decay" generationTool="Tired 1.0"'))
    slave = FmuSlave(path, "decay")
    assert [alone(slave, CALL_LIMIT).outcome for _ in range(3)] == 3 * [Outcome.COMPLETED]
    alone(slave)
    again = alone(slave)
    assert again.outcome is Outcome.INITIALISATION_FAILED
    assert "needs Tired 1.0 on this machine" in again.message


class Parrot(PythonSlave):
    """Says the steps that it has made."""

    name = "parrot"
    variables = (SlaveVariable("word", "output", discrete=True, type="String"),)
    feedthrough = {"word": ()}  # noqa: RUF012

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.steps = 0

    def get(self, indices: Any, values: Any) -> None:
        values[:] = CODES.code(f"step {self.steps}")

    def step(self, time: float, step: float) -> None:
        self.steps += 1


@pytest.mark.parametrize("isolation", [None, ISOLATED])
@pytest.mark.parametrize("compiled", [None, False])
def test_texts_are_signals(make_decay: Make, tmp_path: Path, compiled: bool | None, isolation: float | None) -> None:
    """Strings are connected, recorded and written like any signal, and never to a number."""
    slave = FmuSlave(make_decay(("</ModelVariables>", TEXTS + "</ModelVariables>")), "decay")
    system = connect([Parrot(), slave], [("parrot.word", "decay.word")])
    result = simulate(system, 1.0, 0.25, compiled=compiled, isolation=isolation)
    assert result.recording["decay.said"].shown() == [f'"step {n}, {n}"' for n in range(5)]
    again = Recording.read_csv(result.recording.write_csv(tmp_path / "results.csv"))
    assert again["decay.said"].shown() == result.recording["decay.said"].shown()
    np.testing.assert_array_equal(again["decay.x"].values, result.recording["decay.x"].values)
    with pytest.raises(WiringError, match=r"parrot\.word is String, decay\.u Real"):
        connect([Parrot(), slave], [("parrot.word", "decay.u")])


def test_blanks_and_unicode_in_paths(foreign_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The FMU, and the folder of temporary files with its resources, may be called anything."""
    folder = tmp_path / "Prüf stand №1"
    folder.mkdir()
    path = folder / "träge Masse.fmu"
    path.write_bytes(foreign_fmu.read_bytes())
    with zipfile.ZipFile(path, "a") as target:
        target.writestr("resources/Kennlinie größer 1.txt", "1")
    code = (
        "import sys; from flexfmu.cosim.engine.fmu.slave import FmuSlave; from flexfmu.cosim.engine.master.system import connect;"
        "from flexfmu.cosim.engine.master.simulator import simulate;"
        "print(simulate(connect([FmuSlave(sys.argv[1])], []), 1.0, 0.1).outcome.name)"
    )
    environment = {**os.environ, "TMPDIR": str(folder)}
    done = subprocess.run([sys.executable, "-c", code, str(path)], env=environment, capture_output=True, text=True)
    assert done.stdout == "COMPLETED\n", done.stderr


def test_libraries_that_are_none(foreign_fmu: Path, tmp_path: Path) -> None:
    """A library that can't be loaded gets the system's reason."""
    other = tmp_path / "other.fmu"
    with zipfile.ZipFile(foreign_fmu) as source, zipfile.ZipFile(other, "w") as target:
        for name in source.namelist():
            target.writestr(name, source.read(name) if name.endswith(".xml") else "no library")
    with pytest.raises(FmuFileError, match=r"other\.fmu can't be loaded on this machine: .*; install what is missing"):
        FmuSlave(other)


def test_value_references_have_32_bits(make_decay: Make) -> None:
    """A reference that no function of FMI takes is named with its variable."""
    for reference in ("4294967296", "-1"):
        with pytest.raises(FmuFileError, match=f"the value reference of .* is {reference}; it must be"):
            FmuSlave(make_decay(('valueReference="1"', f'valueReference="{reference}"')))
