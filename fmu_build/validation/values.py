"""Checks that variables have their start values or the values that the importing tool sets."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any
from zlib import crc32

import numpy as np
from fmpy.fmi1 import FMICallException

from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.variables import other_value, size_of, start_value

MOST_TOGETHER = 200
"""Most variables that are set or read in one call."""

PRECISION = 1e-9
"""Relative tolerance for rounding in double precision; single precision errs by 6e-8."""

CLOSE = 1e-6
"""Relative tolerance for numbers that were rounded when printed."""


def starts_are_kept(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that variables with an exact start value have it in Initialization Mode or after it (an event may change it)."""
    variables = [
        variable
        for variable in fmu.description.modelVariables
        if (variable.initial == "exact" or variable.causality == "input" or variable.variability == "constant")
        and start_value(variable) is not None
    ]
    if not variables:
        return
    # read twice: an event at the start may change a value
    with fmu.instance("starts") as instance:
        instance.enter_initialization()
        early = _read(instance, variables)
        instance.library.exitInitializationMode()
        late = _read(instance, variables)
    for variable, *seen in zip(variables, early, late, strict=True):
        start, got = start_value(variable), [value for value in seen if value is not None]
        if got and not any(_is_close(variable, value, start) for value in got):
            message = f"{variable.name} is {_shown(variable, got[-1])} at the start, the description says {start!r}"
            yield Finding(message, "start with what the description says", subject=variable.name)


def _read(instance: Any, variables: Sequence[Any]) -> list[Any]:
    """Values of the variables, read one by one; None where the FMU returns an error."""
    values: list[Any] = []
    for variable in variables:
        try:
            values += instance.read([variable])
        except Exception:  # fmpy's own kinds of errors
            values.append(None)
    return values


def _is_close(variable: Any, value: Any, expected: Any) -> bool:
    if variable.type == "Real":
        return math.isclose(value, expected, rel_tol=CLOSE, abs_tol=CLOSE * size_of(variable) * 1e-3)
    return bool(value == expected)


def _shown(variable: Any, value: Any) -> str:
    if variable.type == "Boolean":
        return repr(bool(value)) if value in (0, 1) else f"{value}, neither fmi2True nor fmi2False,"
    return f"{value:.9g}" if variable.type == "Real" else repr(value)


def parameters_are_kept(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that parameters and inputs keep values set before initialisation, until fmi2Reset."""
    # other values for all settable variables; Reals and other types in separate runs
    changes = {variable: other_value(variable) for variable in fmu.settable("parameter", "input")}
    changes = {variable: value for variable, value in changes.items() if value is not None}
    numbers = {variable: value for variable, value in changes.items() if variable.type == "Real"}
    others = {variable: value for variable, value in changes.items() if variable not in numbers}
    for group in (numbers, others):
        if not group:
            continue
        with fmu.instance("parameters") as instance:
            kept = _kept(instance, group)
            if kept is None:  # the FMU rejects these values
                continue
            # values are kept until the first step, in double precision
            for variable, value in kept.items():
                if not _is_close(variable, value, group[variable]):
                    yield _forgotten(variable, value, group[variable], "after the initialisation, it was set to")
                elif variable.type == "Real" and not math.isclose(
                    value, float(group[variable] or 0.0), rel_tol=PRECISION
                ):
                    message = (
                        f"{variable.name} is {value!r} after the initialisation, it was set to {group[variable]!r}"
                    )
                    remedy = "keep it in double precision"
                    yield Finding(message, remedy, Severity.WARNING, variable.name)
            # fmi2Reset restores the start values
            instance.library.reset()
            instance.enter_initialization()
            instance.library.exitInitializationMode()
            for variable, value in zip(kept, _read(instance, list(kept)), strict=True):
                start = start_value(variable)
                stays = value is not None and _is_close(variable, value, group[variable])
                if stays and not _is_close(variable, value, start):
                    yield _forgotten(variable, value, start, "after fmi2Reset, its start is", "reset")


def tunable_parameters_are_taken(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that tunable parameters can be set while the simulation runs, in model exchange in Event Mode."""
    tunable = [variable for variable in fmu.settable("parameter") if variable.variability == "tunable"]
    if not tunable:
        return
    with fmu.initialized("tunable") as instance:
        instance.advance(0, min(fmu.steps, 3))
        if instance.finished:
            return
        if fmu.kind is InterfaceType.EXCHANGE:
            instance.library.enterEventMode()
        for variable in tunable:
            try:  # the value that it has can't be a wrong one
                instance.write([variable], instance.read([variable]))
            except FMICallException:
                message = f"the tunable parameter {variable.name} is refused while the simulation runs"
                yield Finding(message, "take it at communication points, or call it fixed", subject=variable.name)
                return


def _kept(instance: Any, changes: dict[Any, Any], variables: Sequence[Any] | None = None) -> dict[Any, Any] | None:
    """Set ``changes``, initialise and read these or other variables; None if initialisation fails."""
    try:
        instance.enter_initialization(changes)
        instance.library.exitInitializationMode()
    except Exception:  # fmpy's own kinds of errors
        return None
    wanted = list(changes) if variables is None else variables
    values = zip(wanted, _read(instance, wanted), strict=True)
    return {variable: value for variable, value in values if value is not None}


def _forgotten(variable: Any, value: Any, expected: Any, when: str, check: str = "parameters") -> Finding:
    message = f"{variable.name} is {_shown(variable, value)} {when} {expected!r}"
    return Finding(message, "keep what fmi2SetXXX sets until fmi2Reset", subject=variable.name, check=check)


def one_call_does_what_several_do(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that setting and reading several variables in one call, in shuffled order, equals one call per variable."""
    for kind in ("Real", "Integer", "Enumeration", "Boolean", "String"):
        # read one by one, together, and one by one again
        variables = _shuffled([v for v in fmu.description.modelVariables if v.type == kind])
        with fmu.initialized("read_together") as instance:
            single = {
                v: value for v, value in zip(variables, _read(instance, variables), strict=True) if value is not None
            }
            if len(single) > 1:
                together, again = instance.read(list(single)), _read(instance, list(single))
                for (variable, one), value, last in zip(single.items(), together, again, strict=True):
                    if _differs(variable, one, value) and not _differs(variable, one, last):
                        yield _together(variable, "read", one, value)
        # set the same values one by one, then in one call
        settable = _shuffled(fmu.settable("parameter", "input"))
        changes = {v: other_value(v, 0.013 + 0.001 * n) for n, v in enumerate(settable) if v.type == kind}
        changes = {variable: value for variable, value in changes.items() if value is not None}
        if len(changes) < 2:
            continue
        with fmu.instance("set_one_by_one") as instance:
            kept = _kept(instance, changes)
        if not kept:
            continue
        with fmu.instance("set_together") as instance:
            instance.write_together(list(changes), list(changes.values()))
            changed = _kept(instance, {}, list(kept))
        for variable, value in (changed or {}).items():
            if _differs(variable, kept[variable], value):
                yield _together(variable, "set", kept[variable], value)


def _shuffled(variables: Sequence[Any]) -> list[Any]:
    """At most `MOST_TOGETHER` variables, each value reference once, in a reproducible shuffled order."""
    single = list({(v.type, v.valueReference): v for v in variables}.values())[:MOST_TOGETHER]
    return sorted(single, key=lambda variable: crc32(variable.name.encode()))


def _differs(variable: Any, one: Any, other: Any) -> bool:
    """Whether two values of a variable differ by more than rounding."""
    if variable.type != "Real":
        return bool(one != other)
    return not np.isclose(one, other, rtol=CLOSE, atol=CLOSE * size_of(variable) * 1e-3, equal_nan=True)


def _together(variable: Any, done: str, one: Any, other: Any) -> Finding:
    message = f"{variable.name} is {_shown(variable, other)} where several variables are {done} in one call, "
    message += f"{_shown(variable, one)} where it is {done} alone"
    return Finding(message, "take value n for value reference n", subject=variable.name)
