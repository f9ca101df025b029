"""Checks of illegal FMI calls, which must return an error, and of calls without variables, which must succeed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from ctypes import c_double, c_uint
from typing import Any

from fmpy.fmi1 import FMICallException

from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.library import CANARY, announce

NO_VARIABLE = 0x7FFFFFF1
"""A value reference that no variable has."""


def refuses_illegal_calls(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check illegal calls (unknown value references, wrong state), calls without variables, and writes out of bounds."""
    # calls without variables, and writes out of bounds
    with fmu.instance("calls") as instance:
        instance.initialize()
        yield from _empty_call(instance)
        yield from _overrun(fmu, instance)
    # unknown value references, and calls in the wrong state
    when = f"for the value reference {NO_VARIABLE}, which no variable has"
    yield from _accepted(fmu, _UNKNOWN, True, when, Severity.WARNING)
    yield from _accepted(fmu, _EARLY[fmu.kind], False, "before the initialisation")
    late = _LATE[fmu.kind]
    if fixed := [v for v in fmu.settable("parameter") if v.type == "Real" and v.variability == "fixed"][:1]:
        late = late | {f"fmi2SetReal of the fixed parameter {fixed[0].name}": lambda i: i.write(fixed, i.read(fixed))}
    yield from _accepted(fmu, late, True, "after the initialisation")


FmiCall = Callable[[Any], Any]

_UNKNOWN: dict[str, FmiCall] = {
    "fmi2GetReal": lambda instance: instance.library.getReal([NO_VARIABLE]),
    "fmi2SetReal": lambda instance: instance.library.setReal([NO_VARIABLE], [0.0]),
    "fmi2GetInteger": lambda instance: instance.library.getInteger([NO_VARIABLE]),
    "fmi2GetBoolean": lambda instance: instance.library.getBoolean([NO_VARIABLE]),
}

_EARLY: dict[InterfaceType, dict[str, FmiCall]] = {
    InterfaceType.COSIMULATION: {
        "fmi2ExitInitializationMode": lambda instance: instance.library.exitInitializationMode(),
        "fmi2DoStep": lambda instance: instance.library.doStep(instance.fmu.start, instance.fmu.step),
    },
    InterfaceType.EXCHANGE: {
        "fmi2ExitInitializationMode": lambda instance: instance.library.exitInitializationMode(),
        "fmi2NewDiscreteStates": lambda instance: instance.library.newDiscreteStates(),
    },
}

_LATE: dict[InterfaceType, dict[str, FmiCall]] = {
    InterfaceType.COSIMULATION: {
        "fmi2EnterInitializationMode": lambda instance: instance.library.enterInitializationMode(),
        "fmi2DoStep with a negative step": lambda instance: instance.library.doStep(
            instance.fmu.start, -instance.fmu.step
        ),
    },
    InterfaceType.EXCHANGE: {
        "fmi2EnterInitializationMode": lambda instance: instance.library.enterInitializationMode()
    },
}


def _accepted(
    fmu: FmuUnderTest, calls: dict[str, FmiCall], initialized: bool, when: str, severity: Severity = Severity.NOTE
) -> Iterator[Finding]:
    """Yield one finding for all accepted calls; each call has a separate instance, since an error may end it."""
    accepted = []
    for name, call in calls.items():
        with fmu.instance("illegal") as instance:
            if initialized:
                instance.initialize()
            announce(f"{name} {when}")
            try:
                call(instance)
                accepted.append(name)
            except FMICallException:
                continue
    # one finding for all of them
    if accepted:
        remedy = "return fmi2Error: mistakes of the importing tool stay hidden otherwise"
        yield Finding("calls", f"{', '.join(accepted)} gives fmi2OK {when}", remedy, severity)


def _empty_call(instance: Any) -> Iterator[Finding]:
    try:
        instance.library.getReal([])
    except FMICallException as error:
        yield Finding("calls", f"fmi2GetReal of no variable fails: {error}", "nvr = 0 is legal", Severity.WARNING)


def _overrun(fmu: FmuUnderTest, instance: Any) -> Iterator[Finding]:
    """Yield a finding if fmi2GetReal writes more than nvr values."""
    variables = [variable for variable in fmu.outputs if variable.type == "Real"][:1]
    if variables:
        values = (c_double * 4)(*[CANARY] * 4)
        references = (c_uint * 1)(variables[0].valueReference)
        instance.library.fmi2GetReal(instance.library.component, references, 1, values)
        if any(value != CANARY for value in values[1:]):
            yield Finding("memory", "fmi2GetReal writes more values than nvr", "fill nvr values", section="2.1.7")
