"""FMI 3.0 FMUs as slaves: all types, arrays, events, structural parameters; what can't be run is refused in a sentence."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError, SlaveWarning
from flexfmu.cosim.engine.fmu.sampled_slave import SampledFmu, fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import Outcome, Simulation, simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable
from flexfmu.fmu_build.validation.finding import Severity
from flexfmu.fmu_build.validation.validate import validate_fmu

pytestmark = pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.SlaveWarning")
"""The FMU gives no derivatives of most outputs."""

Make = Callable[..., Path]
INTEGERS = [f"{sign}Int{bits}" for bits in (8, 16, 32, 64) for sign in ("", "U")]


def run(path: Path, stop: float = 1.0, step: float = 0.1, **parameters: Any) -> tuple[FmuSlave, Simulation]:
    """The FMU alone."""
    slave = FmuSlave(path, "guest", parameters)
    return slave, simulate(connect([slave], []), stop=stop, step=step)


@pytest.mark.parametrize("early", ["true", "false"])
def test_events_are_handled_where_they_are(make_events: Make, early: str) -> None:
    """A sawtooth that falls within a communication step, and a time event, are at their instants, whether or not the FMU
    returns early; the FMU refuses calls in a wrong mode."""
    changes = [('mightReturnEarlyFromDoStep="true"', f'mightReturnEarlyFromDoStep="{early}"')]
    if early == "false":
        changes.append(('hasEventMode="true"', ""))
    _, result = run(make_events(*changes), stop=2.0, step=0.1, slope=1.6)
    assert result.outcome is Outcome.COMPLETED, result.message
    time = result.recording.time
    np.testing.assert_allclose(result.recording["guest.x"].values, (1.6 * time) % 1.0, atol=1e-9)
    np.testing.assert_array_equal(result.recording["guest.falls"].values, np.floor(1.6 * time + 1e-9))
    np.testing.assert_array_equal(result.recording["guest.ticks"].values, np.floor(time / 0.25 + 1e-9))


def test_every_type_goes_in_and_out(event_fmu: Path) -> None:
    """Numbers of all types, booleans and texts are set to what they were given, and recorded; ranges are those of the type."""
    given: dict[str, Any] = {"Float32.in": 0.1, "Float64.in": 0.1, "Boolean.in": True, "String.in": "Grüße"}
    given |= {f"{kind}.in": np.iinfo(kind.lower()).min // 2 or 77 for kind in INTEGERS}
    slave, result = run(event_fmu, **given)
    last = {name: column.values[-1] for name, column in result.recording.columns.items()}
    assert last["guest.Float32.out"] == float(np.float32(0.1))
    for kind in ("Float64", "Boolean", *INTEGERS):
        assert last[f"guest.{kind}.out"] == given[f"{kind}.in"], kind
    text = result.recording["guest.String.out"]
    assert text.texts is not None
    assert text.texts[int(text.values[-1])] == "Grüße"
    assert slave.remarks == ()


def test_connected_signals_of_all_types(event_fmu: Path) -> None:
    """One FMU drives another, elements of arrays as well; discrete inputs change at events, of which the FMU takes no others,
    and what doesn't fit into a type stops the run."""
    kinds = ("Float32", "Float64", "Boolean", *INTEGERS)
    wires = [(f"a.{kind}.out", f"b.{kind}.in") for kind in kinds] + [("a.ticks", "b.u[2]")]
    values: dict[str, Any] = {f"{kind}.in": 3 for kind in kinds if kind != "Boolean"} | {"Boolean.in": True}
    slaves = [FmuSlave(event_fmu, "a", values), FmuSlave(event_fmu, "b", {"u[1]": 5.0})]
    result = simulate(connect(slaves, wires), stop=1.0, step=0.25)
    assert result.outcome is Outcome.COMPLETED, result.message
    for kind in kinds:
        assert result.recording[f"b.{kind}.out"].values[-1] == values[f"{kind}.in"], kind
    assert result.recording["b.y[1]"].values[-1] == 5.0
    assert result.recording["b.y[2]"].values[-1] == 4.0
    slaves = [FmuSlave(event_fmu, "a", {"Int32.in": 300}), FmuSlave(event_fmu, "b")]
    result = simulate(connect(slaves, [("a.Int32.out", "b.Int8.in")]), stop=1.0, step=0.25)
    assert result.outcome.is_failure
    assert "Int8.in is of type Int8 and can't be 300" in result.message


def test_arrays_and_structural_parameters(event_fmu: Path) -> None:
    """Arrays have the size that a structural parameter gives them, and are set as a whole or element by element."""
    matrix, vector = np.arange(9.0).reshape(3, 3), [1.0, -1.0, 0.5]
    slave, result = run(event_fmu, n=3, A=matrix, u=vector, offset=0.25)
    found = [result.recording[f"guest.y[{i}]"].values[-1] for i in (1, 2, 3)]
    np.testing.assert_allclose(found, matrix @ vector + 0.25, rtol=1e-15)
    assert slave.feedthrough["y[2]"] == ("u[1]", "u[2]", "u[3]")
    _, result = run(event_fmu, **{"A[1,2]": 10.0, "u[2]": 4.0})
    assert [result.recording[f"guest.y[{i}]"].values[-1] for i in (1, 2)] == [41.0, 4.0]
    with pytest.raises(InputError, match="structural parameters can't vary"):
        slave.vary({"n": 4})


@pytest.mark.parametrize(
    ("trouble", "outcome", "words"),
    [
        ("ends", Outcome.ENDED_BY_SLAVE, "asked to end"),
        ("fails", Outcome.STEP_FAILED, "tired"),
        ("returns", Outcome.STEP_FAILED, "returns from fmi3DoStep"),
        ("updates", Outcome.STEP_FAILED, "discrete states updated"),
    ],
)
def test_an_fmu_ends_fails_and_hangs_with_a_word(event_fmu: Path, trouble: str, outcome: Outcome, words: str) -> None:
    """terminateSimulation is a normal end; a failure has the FMU's own words, and endless events have an end."""
    _, result = run(event_fmu, trouble=trouble)
    assert result.outcome is outcome
    assert words in result.message
    assert "0.5 s" in result.message


def test_states_are_saved_with_their_events(event_fmu: Path) -> None:
    """A step that is taken back meets the same events again: step control repeats all of them."""
    slave = FmuSlave(event_fmu, "guest", {"slope": 0.7})
    assert slave.can_save
    slave.initialize(0.0, 2.0, None)
    indices, before, after = np.array([0, [v.name for v in slave.variables].index("ticks")]), np.empty(2), np.empty(2)
    slave.step(0.0, 0.2)
    state = slave.save()
    slave.step(0.2, 1.8)
    slave.get(indices, before)
    slave.restore(state)
    slave.step(0.2, 1.8)
    slave.get(indices, after)
    slave.terminate()
    np.testing.assert_array_equal(after, before)
    np.testing.assert_allclose(after, [0.4, 8.0], atol=1e-9)
    result = simulate(connect([slave], []), stop=1.0, step=0.1, step_control=StepDoubling(1e-6))
    assert result.outcome is Outcome.COMPLETED, result.message


def test_derivatives_of_outputs(event_fmu: Path) -> None:
    """Output derivatives are those of the outputs that have any; the others are left out with a warning."""
    with pytest.warns(SlaveWarning, match="der"):
        _, result = run(event_fmu, slope=0.5)
    np.testing.assert_array_equal(result.recording["guest.x"].first, 0.5)
    assert result.recording["guest.y[1]"].first is None


def test_sampled_and_with_resources(make_events: Make) -> None:
    """An FMI 3.0 FMU is sampled like any other where it needs one step; its resources are where it is told."""
    path = make_events(
        ('canHandleVariableCommunicationStepSize="true"', ""),
        ("<ModelVariables>", '<DefaultExperiment stepSize="0.25"/><ModelVariables>'),
    )
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("resources/some text.txt", "")
    slave = fmu_slave(path, "guest")
    assert isinstance(slave, SampledFmu)
    result = simulate(connect([slave], []), stop=1.0, step=0.125)
    assert result.outcome is Outcome.COMPLETED, result.message
    assert result.recording["guest.ticks"].values[-1] == 4.0
    where = result.recording["guest.resources"]
    assert where.texts is not None
    assert Path(where.texts[int(where.values[-1])], "some text.txt").is_file()


def test_the_validator_checks_the_description(event_fmu: Path, make_events: Make) -> None:
    """`flexfmu validate` finds what is wrong in the description of an FMI 3.0 FMU, and nothing where it is right."""
    assert not any(each.check == "model description" for each in validate_fmu(event_fmu, run=False))
    worse = validate_fmu(make_events(('<Output valueReference="9" dependencies=""/>', "")), run=False)
    assert any("Outputs" in each.message and each.severity is Severity.ERROR for each in worse)


PERIODIC = (
    '<Clock name="clock0" valueReference="40" causality="input" intervalVariability="constant" intervalDecimal="0.25" shiftDecimal="0.1"/>'
    '<Int32 name="count0" valueReference="50" causality="output" clocks="40"/>'
    '<Float64 name="w" valueReference="60" causality="input" variability="discrete" start="0" clocks="40"/>'
    '<Float64 name="sum" valueReference="61" causality="output" variability="discrete" clocks="40"/>'
)
OTHERS = "".join(
    f'<Clock name="clock{k}" valueReference="{40 + k}" causality="{causality}" intervalVariability="{kind}"/>'
    f'<Int32 name="count{k}" valueReference="{50 + k}" causality="output" clocks="{40 + k}"/>'
    for k, (kind, causality) in enumerate(
        [
            ("changing", "input"),
            ("countdown", "input"),
            ("triggered", "input"),
            ("triggered", "output"),
            ("fixed", "input"),
        ],
        1,
    )
)
OUTPUTS = '<Output valueReference="61" dependencies="60 40"/><Output valueReference="50" dependencies="40"/>'


class Stairs:
    """A source whose integer output grows by one at each multiple of its sample time."""

    name, sample_time, feedthrough = "stairs", 0.25, {"y": ()}
    variables = (SlaveVariable("y", "output", "", 0.0, discrete=True, type="Integer"),)

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.count = 0.0

    def set(self, indices: Indices, values: RealArray) -> None: ...

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.count

    def step(self, time: float, step: float) -> None: ...

    def sample(self, time: float) -> None:
        self.count += 1.0


@pytest.mark.parametrize("step", [0.05, 0.2])
def test_clocks_tick_at_their_instants(make_events: Make, step: float) -> None:
    """Clocks of all kinds tick where they should, on communication points and between them; what the FMU, strict about the modes of
    its clocked variables, adds up in its ticks has the inputs of these very ticks."""
    more = f'{OUTPUTS}<Output valueReference="44" dependencies="40"/>'
    changes = (
        ("<ModelVariables>", f"<ModelVariables>{PERIODIC}{OTHERS}"),
        ("<ModelStructure>", f"<ModelStructure>{more}"),
    )
    slave = FmuSlave(make_events(*changes), "guest")
    assert [v.name for v in slave.variables if v.name.startswith("clock")] == ["clock3", "clock4"]
    wires = [("stairs.y", "guest.clock3"), ("stairs.y", "guest.w")]
    result = simulate(connect([Stairs(), slave], wires), stop=2.0, step=step)
    assert result.outcome is Outcome.COMPLETED, result.message
    time, columns = result.recording.time, {k: v.values for k, v in result.recording.columns.items()}
    periodic = np.floor((time - 0.1 + 1e-9) / 0.25) + 1.0
    expected = {
        "count0": periodic,
        "count1": np.searchsorted([0.1, 0.3, 0.6, 1.0, 1.5], time + 1e-9).astype(float),
        "count2": (time > 0.67 - 1e-9).astype(float),
        "count4": np.floor(periodic / 2.0),
        "clock4": np.floor(periodic / 2.0),
        "count5": np.floor((time - 0.05 + 1e-9) / 0.3) + 1.0,
    }
    last = np.append(np.diff(time) > 0.0, True)  # the right limits
    for name, values in expected.items():
        np.testing.assert_array_equal(columns[f"guest.{name}"][last], values[last], err_msg=name)
    np.testing.assert_array_equal(columns["guest.count3"][last], columns["stairs.y"][last])
    # at t_k = 0.1 s + k 0.25 s the input is the number of stairs at that instant
    given = np.floor((0.1 + 0.25 * np.arange(8)) / 0.25 + 1e-9) + 1.0
    np.testing.assert_array_equal(
        columns["guest.sum"][last], np.append(0.0, np.cumsum(given))[periodic.astype(int)][last]
    )
    assert result.recording["guest.ticks"].values[-1] == 8.0


def test_an_fmu_on_one_clock_is_sampled(event_fmu: Path, make_events: Make) -> None:
    """An FMU whose inputs and outputs all have one periodic clock is sampled at its ticks, with the inputs of the same instant."""
    with zipfile.ZipFile(event_fmu) as archive:
        text = archive.read("modelDescription.xml").decode()
    own = text[text.index("<ModelVariables>") : text.index("</fmi")]
    changes = own, f"<ModelVariables>{PERIODIC}</ModelVariables><ModelStructure>{OUTPUTS}</ModelStructure>"
    slave = fmu_slave(make_events(changes), "guest")
    assert isinstance(slave, SampledFmu)
    assert (slave.sample_time, slave.offset, slave.feedthrough["sum"]) == (0.25, 0.1, ("w",))
    result = simulate(connect([Stairs(), slave], [("stairs.y", "guest.w")]), stop=2.0, step=0.4)
    assert result.outcome is Outcome.COMPLETED, result.message
    assert result.recording["guest.sum"].values[-1] == np.arange(1.0, 9.0).sum()
