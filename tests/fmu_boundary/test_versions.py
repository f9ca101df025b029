"""FMUs of FMI 3.0 beside those of FMI 2.0, from the same numerical part: the same bits, and what only FMI 3.0 has."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator
from ctypes import c_bool, c_uint
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from boundary_support.subjects import scene
from export_support.blocks import delay, pd_controller
from export_support.trajectories import Swing
from fmpy.fmi3 import FMU3Slave
from lxml import etree
from object_files import COMPILER, run

import flexfmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import Simulation, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.exchange.slave_export import export_slaves
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.fmu_build.archive import pack
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.description import TERMINALS
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.fmu_build.sources import BUILD_DESCRIPTION, runtime_sources
from flexfmu.fmu_build.toolchain import FmiVersion, find_compiler, native_platform
from flexfmu.fmu_build.trajectory_build import Motion
from flexfmu.fmu_build.validation.validate import validate_fmu

STOP, STEP = 0.02, 1e-3
BALL = flexfmu.second_order(
    "ball",
    q={"height": 1e-3},
    u={"f": 0.0},
    p={"e": 0.8},
    residual=lambda a, u: a.height + 9.81 - u.f,
    events={"bounce": flexfmu.event(lambda q: q.height, -1, lambda v, p: {"der(height)": -p.e * v.height})},
)
BUILD: dict[str, Callable[[FmiVersion], Path]] = {
    "robot": lambda fmi: build_scene(scene("motion"), fmi=fmi).path,
    "torque-driven robot": lambda fmi: build_scene(scene("torque"), fmi=fmi).path,
    "equations": lambda fmi: build_fmu(BALL, fmi=fmi).path,
    "block": lambda fmi: build_fmu(pd_controller(), fmi=fmi).path,
    "trajectory": lambda fmi: build_fmu(Motion(Swing(kink=0.0123), ["axis"], "m"), fmi=fmi).path,  # type: ignore[arg-type]
}
EXCHANGED = ("robot", "torque-driven robot", "equations")


def by_fmpy(path: Path, kind: str, load: float = 0.0, **more: bool) -> Any:
    """All outputs, the first inputs being ramps, or ``load`` if it isn't 0."""
    description = fmpy.read_model_description(str(path))
    outputs = [each.name for each in description.modelVariables if each.causality == "output"]
    ramps = [each.name for each in description.modelVariables if each.name in ("joint1.torque", "reference")]
    time = np.linspace(0.0, STOP, 21)
    rows = [(instant, *(load or 80.0 * instant for _ in ramps)) for instant in time]
    table = np.array(rows, dtype=[("time", float), *((name, float) for name in ramps)])
    settings = {"step_size": STEP, "output_interval": STEP, "output": sorted(outputs), **more}
    return fmpy.simulate_fmu(str(path), fmi_type=kind, stop_time=STOP, input=table if ramps else None, **settings)


@pytest.mark.parametrize("name", BUILD)
def test_both_versions_give_the_same_bits(name: str) -> None:
    """In fmpy, by steps and integrated by CVODE through the events of stiction and a bounce, and in our master with its derivatives."""
    two, three = BUILD[name]("2"), BUILD[name]("3")
    for kind in ("CoSimulation", "ModelExchange")[: 1 + (name in EXCHANGED)]:
        assert by_fmpy(two, kind).tobytes() == by_fmpy(three, kind).tobytes(), kind
    runs: list[Simulation] = []
    for path in (two, three):
        slave = FmuSlave(path)
        runs.append(simulate(connect([slave], []), stop=STOP, step=STEP))
        assert slave.messages == slave.remarks == ()
    columns = [run.recording.columns for run in runs]
    assert columns[0].keys() == columns[1].keys()
    for one, other in zip(columns[0].values(), columns[1].values(), strict=True):
        np.testing.assert_array_equal(one.values, other.values)
        np.testing.assert_array_equal(one.first, other.first)


def in_fmpy(path: Path, folder: Path) -> tuple[FMU3Slave, dict[str, int]]:
    """An FMU of FMI 3.0 in fmpy, not instantiated, and its value references."""
    description, unpacked = fmpy.read_model_description(str(path)), fmpy.extract(str(path), str(folder))
    names = {"guid": description.guid, "modelIdentifier": description.coSimulation.modelIdentifier}
    references = {each.name: each.valueReference for each in description.modelVariables}
    return FMU3Slave(**names, unzipDirectory=unpacked, instanceName="one"), references


@pytest.fixture
def instance(tmp_path: Path) -> Iterator[tuple[FMU3Slave, dict[str, int]]]:
    """A robot of FMI 3.0 in fmpy, with event mode, and its value references."""
    slave, references = in_fmpy(BUILD["torque-driven robot"]("3"), tmp_path)
    slave.instantiate(eventModeUsed=True, logMessage=lambda *_: None)
    yield slave, references
    slave.freeInstance()


@pytest.mark.parametrize("name", ["torque-driven robot", "equations", "trajectory"])
def test_steps_end_at_events(name: str, tmp_path: Path) -> None:
    """Where the importer allows it, with both sides of each event; between them all is as in steps that handle them, to the last bit."""
    path = BUILD[name]("3")
    inside = by_fmpy(path, "CoSimulation", load=3.0)
    # the start is a breakpoint
    assert inside[1:].tobytes() == by_fmpy(path, "CoSimulation", load=3.0, use_event_mode=True)[1:].tobytes()
    early = by_fmpy(path, "CoSimulation", load=3.0, use_event_mode=True, early_return_allowed=True)
    assert early[np.isin(early["time"], inside["time"])][1:].tobytes() == inside[1:].tobytes()
    after = np.flatnonzero(np.diff(early["time"]) == 0.0) + 1
    assert after.size
    if name == "equations":
        assert early["time"][after].tolist() == pytest.approx([(2e-3 / 9.81) ** 0.5], rel=1e-8)
        assert early["der(height)"][after].tolist() == pytest.approx(-0.8 * early["der(height)"][after - 1], rel=1e-12)
    if name == "trajectory":
        assert early["time"][after].tolist() == [0.0123]
        slave, _ = in_fmpy(path, tmp_path)
        slave.instantiate(eventModeUsed=True)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        assert slave.updateDiscreteStates()[-2:] == (True, 0.0123)
        slave.freeInstance()
        velocity = early["axis.reference.velocity"]
        sides = 9.0 * np.cos(9.0 * 0.0123) * np.array([1.0, -1.0])
        assert [velocity[after - 1][0], velocity[after][0]] == pytest.approx(sides)


@pytest.mark.parametrize("name", BUILD)
def test_descriptions_are_valid(name: str) -> None:
    """Schema, model structure, references and units; schemas of terminals and build description. What the FMU does is judged by
    the other tests."""
    path = BUILD[name]("3")
    assert validate_fmu(path, run=False) == []
    schemas = Path(fmpy.__file__).parent / "schema" / "fmi3"
    with zipfile.ZipFile(path) as archive:
        for schema, member in (("TerminalsAndIcons", TERMINALS), ("BuildDescription", BUILD_DESCRIPTION)):
            rules = etree.XMLSchema(etree.parse(str(schemas / f"fmi3{schema}.xsd")))
            tree = etree.fromstring(archive.read(member))
            rules.assertValid(tree)
            # options are those of a compiler, says VDMCheck3
            assert all("compiler" in each.attrib for each in tree.iter("SourceFileSet"))


def test_input_derivatives_are_arrays(tmp_path: Path) -> None:
    """A planned motion with its derivatives drives the robot in our master to the same bits, whichever version either FMU has; held
    inputs do not."""
    ends = []
    for fmi, order in (("2", None), ("3", None), ("3", 0)):
        system = export_slaves(scene("motion"), tmp_path / fmi, fmi=fmi)  # type: ignore[arg-type]
        plant = FmuSlave(tmp_path / fmi / "plant.fmu", "plant", input_order=order)
        motion = FmuSlave(tmp_path / fmi / "trajectory.fmu", "trajectory")
        run = simulate(connect([motion, plant], system.connections), stop=STOP, step=STEP)
        ends.append([column.values for name, column in run.recording.columns.items() if name.startswith("plant.")])
    np.testing.assert_array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])


def test_adjoint_derivatives_are_the_transpose(instance: tuple[FMU3Slave, dict[str, int]]) -> None:
    """v' (J u) = (J' v)' u for drawn directions of inputs, states and parameters, in initialisation and on the way."""
    slave, references = instance
    outputs = [number for name, number in references.items() if "acceleration" in name or "strain" in name]
    inputs = [references[name] for name in ("joint1.torque", "force.y", "payload.mass")]
    random = np.random.default_rng(1)
    slave.enterInitializationMode()
    for knowns in (inputs, [*inputs, references["joint1.position"], references["der(link11.bending[1])"]]):
        u, v = random.normal(size=len(knowns)), random.normal(size=len(outputs))
        forward = v @ slave.getDirectionalDerivative(outputs, knowns, u)
        adjoint = u @ slave.getAdjointDerivative(outputs, knowns, v, len(knowns))
        assert forward == pytest.approx(adjoint, rel=1e-13)
        if knowns is inputs:
            slave.exitInitializationMode()
            slave.updateDiscreteStates()
            slave.enterStepMode()
            slave.doStep(0.0, STEP)


def test_a_discarded_step_leaves_no_trace(instance: tuple[FMU3Slave, dict[str, int]]) -> None:
    """FMI 3.0, 4.2.1: after fmi3Discard everything is as before the step, which may be tried again."""
    slave, references = instance
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    slave.updateDiscreteStates()
    slave.enterStepMode()
    arrays = [references[f"derivatives.joint{k}.torque"] for k in (1, 2)]
    assert slave.getFloat64(arrays, 18) == 18 * [0.0]
    slave.setFloat64(arrays[:1], [1.5e308, *8 * [0.0]])
    before = slave.serializeFMUState(slave.getFMUState())
    with pytest.raises(fmpy.fmi1.FMICallException, match="discard"):
        slave.doStep(0.0, 0.5)
    assert slave.serializeFMUState(slave.getFMUState()) == before
    slave.setFloat64(arrays[:1], 9 * [0.0])
    assert slave.doStep(0.0, STEP) == (False, False, False, STEP)
    slave.enterEventMode()
    slave.enterStepMode()


def test_intermediate_updates_are_as_good_as_derivatives(tmp_path: Path) -> None:
    """A ball accelerated by sin 30 t in steps of 10 ms: inputs that are set within steps come nearer to the closed form than their derivatives of
    orders 1 to 4 do, a thousand times nearer than held ones. What is read in between is right, too, and a step ends where the importer says."""
    path, stop, size = BUILD["equations"]("3"), 0.5, 0.01
    slave, reference = in_fmpy(path, tmp_path)
    calls: list[tuple[bool, ...]] = []

    def exact(time: float) -> float:
        return float(1e-3 + time / 30.0 - np.sin(30.0 * time) / 900.0)

    def force(time: float) -> float:
        return float(9.81 + np.sin(30.0 * time))

    def update(
        _: Any, time: float, asks: bool, reads: bool, finished: bool, may_end: bool, ends: Any, when: Any
    ) -> None:
        calls.append((asks, reads, finished, may_end))
        if asks:
            slave.setFloat64([reference["f"]], [force(time)])
        elif may_end:
            assert slave.getFloat64([reference["height"]]) == pytest.approx([exact(time)], abs=1e-9)
            ends[0] = len(calls) > 900

    def error(needed: str, *orders: int) -> float:
        nonlocal slave
        slave, _ = in_fmpy(path, tmp_path / f"{needed}{len(orders)}")
        slave.instantiate(
            earlyReturnAllowed=True,
            intermediateUpdate=update,
            requiredIntermediateVariables=[reference[each] for each in needed.split()],
        )
        slave.enterInitializationMode(tolerance=1e-8)
        slave.exitInitializationMode()
        for k in range(round(stop / size)):
            phase = 30.0 * k * size
            slave.setFloat64([reference["f"]], [force(k * size)])
            if orders:
                values = [30.0**order * np.sin(phase + order * np.pi / 2) for order in orders]
                slave.setFloat64([reference["derivatives.f"]], [*values, *(9 - len(orders)) * [0.0]])
            *_, is_early, reached = slave.doStep(k * size, size)
            assert is_early == (len(calls) > 900)
            if is_early:
                break
        value, rate, acceleration = slave.getFloat64(
            [reference[each] for each in ("height", "der(height)", "der(height,2)")]
        )
        arrays = slave.getFloat64([reference["states"], reference["der(states)"]], 4)
        assert arrays == [value, rate, rate, acceleration]
        slave.freeInstance()
        return abs(value - exact(reached))

    held, derivatives = error(""), error("", 1, 2, 3, 4)
    assert not calls
    inside = error("f")
    assert inside < derivatives < 1e-3 * held
    assert calls == 50 * [*4 * [(True, False, False, False)], (False, True, True, False)]
    assert error("f height") < 1e-9
    assert len(calls) == 905


def test_blocks_sample_at_ticks(tmp_path: Path) -> None:
    """A block's outputs in a tick are those of the inputs that are set in it, however often. A tick
    between its instants is refused."""
    slave, reference = in_fmpy(BUILD["block"]("3"), tmp_path)
    slave.instantiate(eventModeUsed=True, logMessage=lambda *_: None)
    slave.enterInitializationMode()
    slave.exitInitializationMode()

    def output(value: float) -> float:
        slave.fmi3SetClock(slave.component, (c_uint * 1)(reference["clock"]), 1, (c_bool * 1)(True))
        slave.setFloat64([reference["in1"]], [value])
        return float(slave.getFloat64([reference["out1"]])[0])

    gain = output(1.0)
    for k in range(3):
        assert output(k) == pytest.approx(k * gain)
        slave.updateDiscreteStates()
        slave.enterStepMode()
        slave.doStep(k * STEP, STEP)
        assert slave.getInt32([reference["statistics.samples"]]) == [k + 1]
        slave.enterEventMode()
    slave.updateDiscreteStates()
    slave.enterStepMode()
    slave.doStep(3 * STEP, 0.5 * STEP)
    slave.enterEventMode()
    with pytest.raises(fmpy.fmi1.FMICallException, match="error"):
        output(1.0)
    slave.freeInstance()


SPOILT = {
    "clocked outputs": ("int is_known = ", "int is_known = 0 && "),
    "inputs in the state": (
        "= arena->used - begin;",
        "= (size_t)((char *)block->inputs.coefficients - (char *)block->record);",
    ),
    "simulation": ('intervalDecimal="0.001"', 'intervalDecimal="0.0015"'),
}
"""Check → what replaces what in the C code or the description of a block, so that the check finds it."""


@pytest.mark.slow
def test_clocked_variables_are_validated(tmp_path: Path) -> None:
    """What is spoilt is found; a clock with an offset, whose ticks lie within the steps, is no fault."""
    assert validate_fmu(build_fmu(delay(offset=4e-4), stop_time=0.02, fmi="3").path) == []
    platform = native_platform()
    sources = generate_sources(pd_controller(), DefaultExperiment(stop_time=0.02), fmi="3")
    for check, change in SPOILT.items():
        code = sources.runtime["block.c"].replace(*change)
        spoilt = replace(
            sources, description=sources.description.replace(*change), runtime=sources.runtime | {"block.c": code}
        )
        binary = compile_library(spoilt, find_compiler(platform))
        library = f"binaries/{platform.folder('3')}/{sources.model_identifier}{platform.suffix}"
        path = tmp_path / "spoilt.fmu"
        path.write_bytes(pack({"modelDescription.xml": spoilt.description.encode(), library: binary}))
        assert spoilt != sources
        assert check in {each.check for each in validate_fmu(path)}


LEGAL = {
    "11111100 both": "SetDebugLogging Reset GetFMUState SetFMUState FreeFMUState SerializedFMUStateSize SerializeFMUState "
    "DeserializeFMUState",
    "11111101 both": "GetFloat64 GetInt32 GetInt64",
    "11110000 both": "SetInt32 SetInt64",
    "11111010 both": "SetFloat64",
    "01111101 both": "GetDirectionalDerivative GetAdjointDerivative",
    "10000000 both": "EnterInitializationMode",
    "01000000 both": "ExitInitializationMode",
    "00101000 both": "EnterEventMode",
    "00111000 both": "Terminate",
    "00010000 both": "UpdateDiscreteStates SetClock",
    "00010000 exchange": "EnterContinuousTimeMode",
    "00001000 exchange": "CompletedIntegratorStep SetContinuousStates",
    "00011000 exchange": "SetTime",
    "01111100 exchange": "GetContinuousStateDerivatives GetEventIndicators GetContinuousStates",
    "11111100 exchange": "GetNominalsOfContinuousStates GetNumberOfEventIndicators GetNumberOfContinuousStates",
    "00010000 stepping": "EnterStepMode",
    "01111101 stepping": "GetOutputDerivatives",
    "00100000 stepping": "DoStep",
}
"""Legal (1) as instantiated, in initialisation, step, event and continuous-time mode, terminated, and in intermediate updates of inputs and
of outputs (FMI 3.0.2, sections 2.3, 3.2 and 4.2), and who has the function; reading derivatives after the end and nominal values before the start are more than the standard allows."""


@pytest.mark.skipif(not COMPILER, reason="no C compiler")
def test_the_runtime_has_the_standards_table(tmp_path: Path) -> None:
    """What the compiler makes of the C table; that it is obeyed is what the fuzzer sees."""
    for header in ("fmi3_states.h", "phases.h"):
        (tmp_path / header).write_text(runtime_sources("plant", "3")[header])
    (tmp_path / "table.c").write_text("""
        #include <stdio.h>
        #include "fmi3_states.h"
        #define X(function, kinds, phases) printf("%d %d " #function "\\n", kinds, phases);
        int main(void) { FLEX_FMI3_CALLS(X) return 0; }
    """)
    run(COMPILER, tmp_path / "table.c", "-o", tmp_path / "table")
    found: dict[str, set[str]] = {}
    for kinds, phases, function in (line.split() for line in run(tmp_path / "table").splitlines()):
        owner = {"1": "stepping", "2": "exchange", "3": "both"}[kinds]
        bits = f"{int(phases):09b}"[::-1]
        found.setdefault(f"{bits[:6]}{bits[7:]} {owner}", set()).add(function.removeprefix("fmi3"))
    assert found == {marks: set(functions.split()) for marks, functions in LEGAL.items()}
