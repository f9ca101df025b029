"""Every FMI function in every state, against the standard's table of calling sequences."""

from __future__ import annotations

import re
from collections.abc import Callable
from ctypes import byref, c_char, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from typing import Any

import pytest
from boundary_support.harness import COMPILER, run
from boundary_support.raw import ERROR, LAST_SUCCESSFUL_TIME, OK, RawInstance, raw_instance
from boundary_support.standard import MARKS, STATES, is_allowed
from boundary_support.subjects import FILES, fail_a_step
from fmpy.fmi2 import fmi2EventInfo

from flexfmu.fmu_build.toolchain import fmi_header_folder

RUNTIME = Path(__file__).parents[2] / "fmu_build" / "c-runtime"
N_STATES = 4
OUTSIDE_THE_TABLE = {"fmi2GetTypesPlatform", "fmi2GetVersion", "fmi2Instantiate", "fmi2FreeInstance"}


def nothing(_instance: RawInstance, _state: c_void_p) -> tuple[Any, ...]:
    return ()


def no_values(_instance: RawInstance, _state: c_void_p) -> tuple[Any, ...]:
    return (None, 0, None)


def no_derivatives(_instance: RawInstance, _state: c_void_p) -> tuple[Any, ...]:
    return (None, 0, None, None)


def one_state(_instance: RawInstance, state: c_void_p) -> tuple[Any, ...]:
    return (state,)


def answer(kind: int, place: Callable[[], Any]) -> Callable[[RawInstance, c_void_p], tuple[Any, ...]]:
    return lambda _instance, _state: (kind, byref(place()))


def first_step(instance: RawInstance, _state: c_void_p) -> tuple[Any, ...]:
    time = c_double()
    instance._slave._functions["fmi2GetRealStatus"](instance._slave.component, LAST_SUCCESSFUL_TIME, byref(time))
    return (time.value, 1e-3, 0)


def bytes_of(instance: RawInstance, state: c_void_p) -> tuple[Any, ...]:
    content = instance.serialized(state)
    return ((c_char * len(content)).from_buffer_copy(content), len(content), byref(c_void_p()))


ARGUMENTS: dict[str, Callable[[RawInstance, c_void_p], tuple[Any, ...]]] = {
    **dict.fromkeys(MARKS["co-simulation"] | MARKS["model exchange"], nothing),
    **{f"fmi2{verb}{kind}": no_values for verb in ("Get", "Set") for kind in ("Real", "Integer", "Boolean", "String")},
    "fmi2SetRealInputDerivatives": no_derivatives,
    "fmi2GetRealOutputDerivatives": no_derivatives,
    "fmi2SetDebugLogging": lambda _instance, _state: (1, 0, None),
    "fmi2SetupExperiment": lambda _instance, _state: (0, 0.0, 0.0, 0, 0.0),
    "fmi2GetFMUstate": lambda _instance, _state: (byref(c_void_p()),),
    "fmi2SetFMUstate": one_state,
    "fmi2FreeFMUstate": lambda _instance, _state: (byref(c_void_p()),),
    "fmi2SerializedFMUstateSize": lambda _instance, state: (state, byref(c_size_t())),
    "fmi2SerializeFMUstate": lambda _instance, state: (state, (c_char * 100000)(), 100000),
    "fmi2DeSerializeFMUstate": bytes_of,
    "fmi2GetDirectionalDerivative": lambda _instance, _state: ((c_uint * 1)(), 0, (c_uint * 1)(), 0, None, None),
    "fmi2DoStep": first_step,
    "fmi2NewDiscreteStates": lambda _instance, _state: (byref(fmi2EventInfo()),),
    "fmi2CompletedIntegratorStep": lambda _instance, _state: (1, byref(c_int()), byref(c_int())),
    "fmi2SetTime": lambda _instance, _state: (0.0,),
    "fmi2SetContinuousStates": lambda _instance, _state: ((c_double * N_STATES)(), N_STATES),
    "fmi2GetDerivatives": lambda _instance, _state: ((c_double * N_STATES)(), N_STATES),
    "fmi2GetContinuousStates": lambda _instance, _state: ((c_double * N_STATES)(), N_STATES),
    "fmi2GetNominalsOfContinuousStates": lambda _instance, _state: ((c_double * N_STATES)(), N_STATES),
    "fmi2GetEventIndicators": lambda _instance, _state: (None, 0),
    "fmi2GetStatus": answer(0, c_int),
    "fmi2GetRealStatus": answer(LAST_SUCCESSFUL_TIME, c_double),
    "fmi2GetIntegerStatus": answer(0, c_int),
    "fmi2GetBooleanStatus": answer(3, c_int),
    "fmi2GetStringStatus": answer(1, c_char_p),
}
"""Harmless arguments of each function."""

CASES = [
    (name, kind, state)
    for name in FILES
    for kind, state in STATES
    if (name == "robot" or kind == "co-simulation") and (name, state) != ("trajectory", "step failed")
]
"""Only robots have states to exchange, and a trajectory has no step that fails."""


def bring_to(instance: RawInstance, name: str, state: str) -> None:
    """By the shortest way."""
    if state != "instantiated":
        assert instance.call("fmi2EnterInitializationMode") == OK
    if state not in ("instantiated", "initialization"):
        assert instance.call("fmi2ExitInitializationMode") == OK
    if state == "step failed":
        fail_a_step(instance, name)
    if state == "continuous-time mode":
        assert instance.call("fmi2EnterContinuousTimeMode") == OK
    if state == "terminated":
        assert instance.call("fmi2Terminate") == OK


def test_the_tables_have_all_functions() -> None:
    """A function that is forgotten here is not held to the standard."""
    declared = set(re.findall(r"fmi2FullName\((fmi2\w+)\)", (fmi_header_folder() / "fmi2Functions.h").read_text()))
    stepping, exchange = (set(MARKS[kind]) for kind in ("co-simulation", "model exchange"))
    assert stepping | exchange == declared - OUTSIDE_THE_TABLE
    assert (len(stepping), len(exchange), len(stepping & exchange)) == (30, 31, 21)


PHASES = {
    "instantiated": "INSTANTIATED",
    "initialization": "INITIALISATION_MODE",
    "step complete": "STEP_COMPLETE",
    "step failed": "STEP_FAILED",
    "event mode": "EVENT_MODE",
    "continuous-time mode": "CONTINUOUS_TIME_MODE",
    "terminated": "TERMINATED",
}
KINDS = {"co-simulation": "STEPPING", "model exchange": "EXCHANGE"}
"""State and kind of the standard → name in the runtime's table."""


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_the_runtime_has_the_standards_table(tmp_path: Path) -> None:
    """Each function is there for the kinds and in the states of the standard: what the compiler makes of the C table."""
    (header,) = RUNTIME.rglob("fmi2_states.h")
    columns = ", ".join(f"(k & {KINDS[kind]}) && (p & {PHASES[state]})" for kind, state in STATES)
    columns += "".join(f", (k & {kind}) != 0" for kind in KINDS.values())
    source, program = tmp_path / "table.c", tmp_path / "table"
    source.write_text(f"""
        #include <stdio.h>
        #include "{header}"
        static void show(const char *name, int k, int p) {{
          const int served[] = {{{columns}}};
          printf("%s", name);
          for (unsigned i = 0; i < sizeof served / sizeof *served; i++) printf(" %d", served[i]);
          puts("");
        }}
        int main(void) {{
        #define X(function, kinds, phases) show(#function, kinds, phases);
          FLEX_FMI2_CALLS(X)
          return 0;
        }}
    """)
    run(COMPILER, source, "-o", program)
    found = {name: marks for name, *marks in (line.split() for line in run(program).splitlines())}
    expected = {
        name: [
            *(str(int(name in MARKS[kind] and is_allowed(kind, name, state))) for kind, state in STATES),
            *(str(int(name in MARKS[kind])) for kind in KINDS),
        ]
        for name in MARKS["co-simulation"] | MARKS["model exchange"]
    }
    assert found == expected


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind", "state"), CASES)
def test_calls_are_served_and_refused_as_the_standard_says(name: str, kind: str, state: str, tmp_path: Path) -> None:
    """Importers rely on the calls that the standard allows, and on being told of the others."""
    path = FILES[name]()
    wrong = []
    for function in MARKS[kind]:
        with raw_instance(path, tmp_path / "fmu", kind) as instance:
            bring_to(instance, name, state)
            saved = instance.save()
            heard = len(instance.heard)
            instance.call(function, *ARGUMENTS[function](instance, saved))
            said = " ".join(each.text for each in instance.heard[heard:])
            refused = f"{function} must not be called in the state '" in said
            if refused == is_allowed(kind, function, state):
                wrong.append((function, state, said))

            # a refused call leaves the instance as it was; rollback and reset are always possible
            if refused:
                assert instance.serialized(instance.save()) == instance.serialized(saved)
            assert instance.call("fmi2SetFMUstate", saved) == OK
            assert instance.call("fmi2Reset") == OK
            instance.start()
    assert wrong == []


def test_calls_of_the_other_kind_are_refused(tmp_path: Path) -> None:
    """An importer that steps what it should integrate has mixed up its FMUs."""
    path = FILES["robot"]()
    for kind, other in (("co-simulation", "model exchange"), ("model exchange", "co-simulation")):
        for function in set(MARKS[other]) - set(MARKS[kind]):
            with raw_instance(path, tmp_path / "fmu", kind) as instance:
                instance.start()
                arguments = (0.0, 1e-3, 0) if function == "fmi2DoStep" else ARGUMENTS[function](instance, c_void_p())
                assert instance.call_other(function, *arguments) == ERROR
                assert f"this instance was made for {kind}" in instance.sentence
