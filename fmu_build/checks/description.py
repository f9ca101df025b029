"""What the model description says of itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fmpy.model_description import read_model_description
from fmpy.validation import validate_fmu as validate_by_fmpy

from flexfmu.fmu_build.finding import Finding, Severity

_NUMBERS = {"Real", "Integer", "Enumeration"}


def read_description(path: Path) -> tuple[Any | None, list[Finding]]:
    """The description as fmpy reads it, None where it cannot; and what fmpy's rules find."""
    findings = [_broken(problem) for problem in validate_by_fmpy(str(path))]
    try:
        return read_model_description(str(path), validate=False), findings
    except Exception as error:  # whatever fmpy and lxml make of a broken description
        return None, findings or [_broken(str(error))]


def check_description(description: Any) -> Iterator[Finding]:
    """Findings that fmpy's rules leave out.

    Args:
        description: model description as fmpy reads it.
    """
    if description.fmiVersion != "2.0" or not interfaces(description):
        yield _broken(
            f"this is no FMI 2.0 FMU for co-simulation or model exchange (fmiVersion {description.fmiVersion})"
        )
    if not description.guid:
        yield Finding("guid", "the attribute guid is empty", "it ties description and binary together: generate one")
    for variable in description.modelVariables:
        yield from _check_numbers(variable)


def interfaces(description: Any) -> list[Any]:
    """The elements CoSimulation and ModelExchange that are there."""
    return [element for element in (description.coSimulation, description.modelExchange) if element is not None]


def _check_numbers(variable: Any) -> Iterator[Finding]:
    """Range, start and nominal of a variable against each other."""
    if variable.type not in _NUMBERS:
        return
    low, high = _number(variable.min, -math.inf), _number(variable.max, math.inf)
    start = _number(variable.start, None)
    if low > high:
        yield Finding("range", f"{variable.name} has min {low:g} above max {high:g}", "exchange them")
    if start is not None and not math.isfinite(start):
        yield Finding("start value", f"{variable.name} starts at {start}", "give a finite start value")
    elif start is not None and not low <= start <= high:
        yield Finding(
            "start value", f"{variable.name} starts at {start}, outside {low} to {high}", "correct start, min or max"
        )
    if _number(variable.nominal, 1.0) == 0.0:
        yield Finding("nominal", f"{variable.name} has nominal 0", "give its order of magnitude", Severity.WARNING)


def _number(text: str | None, default: Any) -> Any:
    if text is None:
        return default
    try:
        return float(text)
    except ValueError:  # fmpy's rules have told
        return default


def _broken(problem: str) -> Finding:
    return Finding("model description", " ".join(problem.split()), "correct modelDescription.xml")
