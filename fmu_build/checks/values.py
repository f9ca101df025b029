"""Whether variables have the values that the description or the importing tool gives them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from flexfmu.fmu_build.checks.fmu import FmuUnderTest, other_value, size_of, start_value
from flexfmu.fmu_build.finding import Finding

CLOSE = 1e-6
"""Difference of two numbers relative to their size that is but the rounding of a printed number."""


def starts_are_kept(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Variables with an exact start have it, in Initialization Mode or after it: events may come in between."""
    variables = [
        variable
        for variable in fmu.description.modelVariables
        if (variable.initial == "exact" or variable.causality == "input" or variable.variability == "constant")
        and start_value(variable) is not None
    ]
    if not variables:
        return
    with fmu.instance("starts") as instance:
        instance.enter_initialization()
        early = _read(instance, variables)
        instance.library.exitInitializationMode()
        late = _read(instance, variables)
    for variable, *seen in zip(variables, early, late, strict=True):
        start, got = start_value(variable), [value for value in seen if value is not None]
        if got and not any(_is_close(variable, value, start) for value in got):
            message = f"{variable.name} is {_shown(variable, got[-1])} at the start, the description says {start!r}"
            yield Finding("start value", message, "start with what the description says", subject=variable.name)


def _read(instance: Any, variables: Sequence[Any]) -> list[Any]:
    """Values one by one, None where the FMU refuses to tell."""
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
    return (
        repr(bool(value)) if variable.type == "Boolean" else f"{value:.9g}" if variable.type == "Real" else repr(value)
    )


def parameters_are_kept(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Parameters and inputs keep what is set before the initialisation, and forget it at a reset."""
    changes = {variable: other_value(variable) for variable in fmu.settable("parameter", "input")}
    changes = {variable: value for variable, value in changes.items() if value is not None}
    numbers = {variable: value for variable, value in changes.items() if variable.type == "Real"}
    others = {variable: value for variable, value in changes.items() if variable.type != "Real"}
    for group in (numbers, others):
        if not group:
            continue
        with fmu.instance("parameters") as instance:
            kept = _kept(instance, group)
            if kept is None:  # the FMU can't run with these values, and says so
                continue
            for variable, value in kept.items():
                if not _is_close(variable, value, group[variable]):
                    yield _forgotten(variable, value, group[variable], "after the initialisation, it was set to")
            instance.reset()
            instance.enter_initialization()
            instance.library.exitInitializationMode()
            for variable, value in zip(kept, _read(instance, list(kept)), strict=True):
                start = start_value(variable)
                stays = value is not None and _is_close(variable, value, group[variable])
                if stays and not _is_close(variable, value, start):
                    yield _forgotten(variable, value, start, "after fmi2Reset, its start is", "reset")


def _kept(instance: Any, changes: dict[Any, Any]) -> dict[Any, Any] | None:
    """Values after the initialisation of what was set before; None if that fails."""
    try:
        instance.enter_initialization(changes)
        instance.library.exitInitializationMode()
    except Exception:  # fmpy's own kinds of errors
        return None
    values = zip(changes, _read(instance, list(changes)), strict=True)
    return {variable: value for variable, value in values if value is not None}


def _forgotten(variable: Any, value: Any, expected: Any, when: str, check: str = "parameters") -> Finding:
    message = f"{variable.name} is {_shown(variable, value)} {when} {expected!r}"
    return Finding(check, message, "keep what fmi2SetXXX sets until fmi2Reset", subject=variable.name)
