"""Every FMI function in every state, against the standard's table of calling sequences: FMI 2.0.4, sections 3.2.3 and 4.2.4.

The states "step in progress" and "step canceled" are those of asynchronous steps, which our FMUs don't make; "error" is left to
the importer: after a refused call the instance is where it was. That legal calls are served is what the fuzzer sees.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from boundary_support.raw import ERROR, OK, RawInstance, raw_instance
from boundary_support.subjects import FILES, fail_a_step
from object_files import COMPILER, run

from flexfmu.fmu_build.sources import runtime_sources
from flexfmu.fmu_build.toolchain import fmi_header_folder

OUTSIDE_THE_TABLE = {"fmi2GetTypesPlatform", "fmi2GetVersion", "fmi2Instantiate", "fmi2FreeInstance"}

STATES = {
    "co-simulation": ("INSTANTIATED", "INITIALISATION_MODE", "STEP_COMPLETE", "STEP_FAILED", "TERMINATED"),
    "model exchange": ("INSTANTIATED", "INITIALISATION_MODE", "EVENT_MODE", "CONTINUOUS_TIME_MODE", "TERMINATED"),
}
KINDS = {"co-simulation": "STEPPING", "model exchange": "EXCHANGE"}
"""Kind of instance → its states, and its own name, in the runtime."""

TABLE = """
fmi2SetDebugLogging               x  x  x  x  x    x  x  x  x  x
fmi2SetupExperiment               x  -  -  -  -    x  -  -  -  -
fmi2EnterInitializationMode       x  -  -  -  -    x  -  -  -  -
fmi2ExitInitializationMode        -  x  -  -  -    -  x  -  -  -
fmi2Terminate                     -  -  x  x  -    -  -  x  x  -
fmi2Reset                         x  x  x  x  x    x  x  x  x  x
fmi2GetReal                       +  x  x  x  x    +  x  x  x  x
fmi2GetInteger                    +  x  x  x  x    +  x  x  x  x
fmi2GetBoolean                    -  x  x  x  x    -  x  x  x  x
fmi2GetString                     -  x  x  x  x    -  x  x  x  x
fmi2SetReal                       x  x  x  +  -    x  x  x  x  -
fmi2SetInteger                    x  x  x  +  -    x  x  x  -  -
fmi2SetBoolean                    x  x  x  +  -    x  x  x  -  -
fmi2SetString                     x  x  x  +  -    x  x  x  -  -
fmi2GetFMUstate                   x  x  x  x  x    x  x  x  x  x
fmi2SetFMUstate                   x  x  x  x  x    x  x  x  x  x
fmi2FreeFMUstate                  x  x  x  x  x    x  x  x  x  x
fmi2SerializedFMUstateSize        x  x  x  x  x    x  x  x  x  x
fmi2SerializeFMUstate             x  x  x  x  x    x  x  x  x  x
fmi2DeSerializeFMUstate           x  x  x  x  x    x  x  x  x  x
fmi2GetDirectionalDerivative      -  x  x  x  x    -  x  x  x  x
fmi2SetRealInputDerivatives       x  x  x  +  -    no
fmi2GetRealOutputDerivatives      -  +  x  x  x    no
fmi2DoStep                        -  -  x  +  -    no
fmi2CancelStep                    -  -  -  -  -    no
fmi2GetStatus                     -  -  x  x  x    no
fmi2GetRealStatus                 -  -  x  x  x    no
fmi2GetIntegerStatus              -  -  x  x  x    no
fmi2GetBooleanStatus              -  -  x  x  x    no
fmi2GetStringStatus               -  -  x  x  x    no
fmi2EnterEventMode                no               -  -  x  x  -
fmi2NewDiscreteStates             no               -  -  x  -  -
fmi2EnterContinuousTimeMode       no               -  -  x  -  -
fmi2CompletedIntegratorStep       no               -  -  -  x  -
fmi2SetTime                       no               -  -  x  x  -
fmi2SetContinuousStates           no               -  -  -  x  -
fmi2GetDerivatives                no               -  +  x  x  x
fmi2GetEventIndicators            no               -  x  x  x  x
fmi2GetContinuousStates           no               -  x  x  x  x
fmi2GetNominalsOfContinuousStates no               x  +  x  x  x
"""
"""Five states of co-simulation and of model exchange. x: allowed, +: allowed by our FMUs beyond the standard, -: refused; no: not
a function of that kind."""

MARKS: dict[str, dict[str, list[str]]] = {kind: {} for kind in STATES}
"""Kind of instance → function → mark for each of its states."""
for line in TABLE.strip().splitlines():
    function, *marks = line.split()
    for own in MARKS.values():
        if marks[0] == "no":
            del marks[0]
        else:
            own[function], marks = marks[:5], marks[5:]

EACH = [(kind, index) for kind, states in STATES.items() for index in range(len(states))]


def bring_to(instance: RawInstance, state: str) -> None:
    """By the shortest way."""
    if state != "INSTANTIATED":
        assert instance.call("fmi2EnterInitializationMode") == OK
    if state not in ("INSTANTIATED", "INITIALISATION_MODE"):
        assert instance.call("fmi2ExitInitializationMode") == OK
    if state == "STEP_FAILED":
        fail_a_step(instance, "robot")
    if state == "CONTINUOUS_TIME_MODE":
        assert instance.call("fmi2EnterContinuousTimeMode") == OK
    if state == "TERMINATED":
        assert instance.call("fmi2Terminate") == OK


def refused(instance: RawInstance, function: str) -> str:
    """What a call without sensible arguments hears, which is refused before these are looked at."""
    assert instance.call_with_nothing(function) == ERROR, function
    return instance.sentence


@pytest.mark.skipif(not COMPILER, reason="no C compiler")
def test_the_runtime_has_the_standards_table(tmp_path: Path) -> None:
    """Each declared function is there for the kinds and in the states of the standard: what the compiler makes of the C table."""
    declared = set(re.findall(r"fmi2FullName\((fmi2\w+)\)", (fmi_header_folder() / "fmi2Functions.h").read_text()))
    assert MARKS["co-simulation"].keys() | MARKS["model exchange"].keys() == declared - OUTSIDE_THE_TABLE
    for header in ("fmi2_states.h", "phases.h"):
        (tmp_path / header).write_text(runtime_sources("plant")[header])
    constants = {*KINDS.values(), *STATES["co-simulation"], *STATES["model exchange"]}
    source, program = tmp_path / "table.c", tmp_path / "table"
    source.write_text(f"""
        #include <stdio.h>
        #include "fmi2_states.h"
        #define X(function, kinds, phases) printf("%s %d %d\\n", #function, kinds, phases);
        int main(void) {{
          {" ".join(f"X({each}, {each}, 0)" for each in constants)}
          FLEX_FMI2_CALLS(X)
          return 0;
        }}
    """)
    run(COMPILER, source, "-o", program)
    lines = (line.split() for line in run(program).splitlines())
    found = {name: (int(kinds), int(phases)) for name, kinds, phases in lines}
    assert found.keys() - constants == declared - OUTSIDE_THE_TABLE
    for name in declared - OUTSIDE_THE_TABLE:
        kinds, phases = found[name]
        for kind, states in STATES.items():
            assert bool(kinds & found[KINDS[kind]][0]) == (name in MARKS[kind])
            served = ["x" if phases & found[state][0] else "-" for state in states]
            assert name not in MARKS[kind] or served == [mark.replace("+", "x") for mark in MARKS[kind][name]], name


@pytest.mark.parametrize(("kind", "index"), EACH, ids=lambda part: str(part))
def test_illegal_calls_are_refused_and_leave_no_trace(kind: str, index: int, tmp_path: Path) -> None:
    """Importers rely on being told of calls that the standard doesn't allow, those of the other kind of instance included; rollback and
    reset are always possible."""
    (other,) = {*KINDS} - {kind}
    with raw_instance(FILES["robot"](), tmp_path / "fmu", kind) as instance:
        bring_to(instance, STATES[kind][index])
        saved = instance.save()
        content = instance.serialized(saved)
        for function, marks in MARKS[kind].items():
            if marks[index] == "-":
                assert f"{function} must not be called in the state '" in refused(instance, function)
        for function in MARKS[other].keys() - MARKS[kind].keys():
            assert f"this instance was made for {kind}" in refused(instance, function)
        assert instance.serialized(instance.save()) == content
        assert instance.call("fmi2SetFMUstate", saved) == instance.call("fmi2Reset") == OK
        instance.start()
