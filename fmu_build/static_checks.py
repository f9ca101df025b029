"""What can be said of an FMU without running it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import fmpy
from fmpy.model_description import read_model_description
from fmpy.validation import validate_fmu as validate_by_fmpy

from flexfmu.fmu_build.elf import NotElfError, exported_symbols
from flexfmu.fmu_build.finding import Finding

_COMMON = (
    "GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment EnterInitializationMode "
    "ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString "
    "GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate "
    "GetDirectionalDerivative"
)
_COSIMULATION = (
    "SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus GetIntegerStatus "
    "GetBooleanStatus GetStringStatus"
)
FUNCTIONS = frozenset(f"fmi2{name}" for name in f"{_COMMON} {_COSIMULATION}".split())
"""All functions of an FMI 2.0 co-simulation FMU."""


def check_statically(path: Path, files: Mapping[str, bytes]) -> list[Finding]:
    """Findings about description and binary.

    Args:
        path: the FMU.
        files: its content, path inside → bytes.
    """
    findings = [Finding("model description", _one_line(problem)) for problem in validate_by_fmpy(str(path))]
    try:
        description = read_model_description(str(path), validate=False)
    except Exception as error:  # whatever fmpy and lxml make of a broken description
        return findings or [Finding("model description", _one_line(str(error)))]
    if description.fmiVersion != "2.0" or description.coSimulation is None:
        return [*findings, Finding("model description", "this is no FMI 2.0 FMU for co-simulation")]
    return [*findings, *_check_guid(description), *_check_starts(description), *_check_binary(description, files)]


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _check_guid(description: Any) -> Iterator[Finding]:
    if not description.guid:
        yield Finding("guid", "the attribute guid is empty; it ties description and binary together")


def _check_starts(description: Any) -> Iterator[Finding]:
    for variable in description.modelVariables:
        if variable.type != "Real" or variable.start is None:
            continue
        start = float(variable.start)
        low = float("-inf" if variable.min is None else variable.min)
        high = float("inf" if variable.max is None else variable.max)
        if not low <= start <= high:
            yield Finding("start value", f"{variable.name} starts at {start}, outside {low} to {high}")


def _check_binary(description: Any, files: Mapping[str, bytes]) -> Iterator[Finding]:
    folder = f"binaries/{fmpy.platform}/"
    name = f"{folder}{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
    if name not in files:
        others = sorted(file for file in files if file.startswith(folder)) or ["nothing"]
        yield Finding("binary", f"{name} is missing; {folder} has {', '.join(others)}")
    elif fmpy.system == "linux":
        yield from _check_exports(name, files[name])


def _check_exports(name: str, library: bytes) -> Iterator[Finding]:
    try:
        symbols = exported_symbols(library)
    except NotElfError as error:
        yield Finding("binary", f"{name}: {error}")
        return
    missing = sorted(FUNCTIONS - symbols)
    foreign = sorted(symbol for symbol in symbols if not symbol.startswith("fmi2"))
    if missing:
        yield Finding("binary", f"{name} does not export {', '.join(missing)}")
    if foreign:
        yield Finding("binary", f"{name} exports {', '.join(foreign)} besides the FMI functions; hide them")
