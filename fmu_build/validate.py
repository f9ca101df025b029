"""Is this FMU sound? Static checks of description and binaries, then a short life of it in another process."""

from __future__ import annotations

import io
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy

from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.finding import Finding, Severity

TIMEOUT = 300.0
"""Longest time for what runs the FMU [s]; the paper's scene needs a few seconds."""


_FMI3 = Finding(
    "model description",
    "an FMU of FMI 3.0: its description is checked by fmpy, what it does is not",
    "run it, and compare with the tool that it comes from",
    Severity.NOTE,
)


def validate_fmu(path: Path, timeout: float = TIMEOUT) -> list[Finding]:
    """Check any FMU 2.0, for co-simulation, model exchange or both; an empty list says that nothing was found. Of an FMU 3.0
    the description alone is checked.

    Static: archive, `fmpy.validation.validate_fmu`, GUID, start values, the binaries' names, exports and dependencies.
    Dynamic, in processes of their own so that a crash is a finding too, and each claim of the description tried for real:
    the catalogue in `flexfmu.fmu_build.checks.catalogue`.

    Args:
        path: the FMU.
        timeout: longest time for the dynamic checks of one interface [s].

    Raises:
        ArchiveError: the file is missing, no zip archive, damaged, or has no modelDescription.xml.
    """
    from flexfmu.fmu_build.checks.archive import check_archive
    from flexfmu.fmu_build.checks.binaries import check_binaries, library_name
    from flexfmu.fmu_build.checks.description import check_description, interfaces, read_description

    files = _read(path)
    description, findings = read_description(path)
    if description is None:
        return findings
    if str(description.fmiVersion).startswith("3."):
        return [*findings, _FMI3]
    findings += [*check_description(description), *check_archive(files)]
    if not interfaces(description) or description.fmiVersion != "2.0":
        return findings
    findings += check_binaries(description, files)
    if library_name(description, fmpy.platform) in files:
        findings += _check_dynamically(path, description, timeout)
    return findings


def _check_dynamically(path: Path, description: Any, timeout: float) -> list[Finding]:
    from flexfmu.fmu_build.checks.catalogue import CHECKS
    from flexfmu.fmu_build.checks.fmu import Kind
    from flexfmu.fmu_build.checks.parent import check_in_child

    elements = {Kind.COSIMULATION: description.coSimulation, Kind.EXCHANGE: description.modelExchange}
    found: dict[str, list[Finding]] = {}
    for kind, element in elements.items():
        if element is not None:
            found[kind.value] = check_in_child(path, kind, tuple(CHECKS), timeout)
            if element.needsExecutionTool and any(finding.check == "instantiation" for finding in found[kind.value]):
                found[kind.value] = [_no_tool(kind.value)]
    return _merged(found)


def _no_tool(interface: str) -> Finding:
    message = f"for {interface} the FMU needs its own tool (needsExecutionTool) and makes no instance here"
    return Finding("instantiation", message, "run this where the tool is", Severity.NOTE)


def _merged(found: dict[str, list[Finding]]) -> list[Finding]:
    """Findings of all interfaces: what both show once, the rest with the interface's name."""
    common = set.intersection(*(set(findings) for findings in found.values()))
    named = (
        finding if finding in common or len(found) == 1 else replace(finding, message=f"{name}: {finding.message}")
        for name, findings in found.items()
        for finding in findings
    )
    return list(dict.fromkeys(named))


def _read(path: Path) -> dict[str, bytes]:
    """Content of the archive, path inside → bytes; every entry is read, so its checksum is checked."""
    try:
        content = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        raise ArchiveError(
            f"no FMU at {path}; build one with: flexfmu build SCENE -o {path.name or 'NAME.fmu'}"
        ) from error
    except OSError as error:
        raise ArchiveError(f"cannot read the FMU {path}: {error.strerror}; check its permissions") from error
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            files = {entry.filename: archive.read(entry) for entry in archive.infolist() if not entry.is_dir()}
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise ArchiveError(f"{path} is no intact FMU (zip archive): {error}; build it again") from error
    if "modelDescription.xml" not in files:
        raise ArchiveError(f"{path} is a zip archive but no FMU: modelDescription.xml is missing")
    return files
