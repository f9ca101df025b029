"""Is this FMU sound? Static checks of archive, description and binaries, then a short life of it in another process."""

from __future__ import annotations

import io
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

import fmpy

from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.validation.archive import check_archive, check_entries
from flexfmu.fmu_build.validation.binaries import check_binaries, library_name
from flexfmu.fmu_build.validation.catalogue import CHECKS, SEVERAL
from flexfmu.fmu_build.validation.description import (
    check_description,
    fmi_version,
    interfaces,
    is_stumble,
    read_description,
)
from flexfmu.fmu_build.validation.finding import Finding, Severity, ranked
from flexfmu.fmu_build.validation.fmu import Kind
from flexfmu.fmu_build.validation.parent import check_in_child

TIME_LIMIT = 120.0
"""Longest time for what runs the FMU [s]; the paper's scene needs a few seconds."""


_FLAGS, _ENCRYPTED = 6, 1
"""Where the flags are in the header before each file of an archive, and the one for encryption."""

_FMI3 = Finding(
    "model description",
    "an FMU of FMI 3.0: its description is checked by fmpy, what it does is not",
    "run it, and compare with the tool that it comes from",
    Severity.NOTE,
    section="FMI 3.0, 2.4",
)


def validate_fmu(path: Path, time_limit: float = TIME_LIMIT, run: bool = True) -> list[Finding]:
    """Check any FMU 2.0, for co-simulation, model exchange or both; an empty list says that nothing was found.
    Of an FMU 3.0 the description alone is checked.

    Static: archive, `fmpy.validation.validate_fmu`, what it leaves out, the binaries' names, exports and dependencies.
    Dynamic, in processes of their own so that a crash is a finding too, and each claim of the description tried for real:
    the catalogue in `flexfmu.fmu_build.validation.catalogue`. The processes end with this one, however it ends.

    Args:
        path: the FMU.
        time_limit: longest time for the dynamic checks [s]; one FMI call may take a fifth of it.
        run: whether the FMU may run; otherwise the checks are static.

    Returns:
        Findings, those of the same kind together, the worst first.

    Raises:
        ArchiveError: the file is missing, no zip archive, damaged, or has no modelDescription.xml.
    """
    entries, files, encrypted = _read(path)
    version = fmi_version(files["modelDescription.xml"])
    if version.startswith("3."):
        broken = [replace(finding, section=_FMI3.section) for finding in read_description(path)[1]]
        return ranked([*broken, _FMI3])
    if version != "2.0":
        message = f"fmiVersion is {version or 'missing'}: FMUs of version 2.0 are checked, of 3.0 the description"
        return [Finding("model description", message, "export the model as FMI 2.0", section="2.2.1")]
    description, findings = read_description(path)
    described = list(check_description(files["modelDescription.xml"]))
    if any(finding.severity is Severity.ERROR for finding in described):
        findings = [finding for finding in findings if not is_stumble(finding)]
    findings += [*described, *check_entries(entries, encrypted), *check_archive(files)]
    if description is not None and interfaces(description):
        findings += check_binaries(description, files)
        if run and library_name(description, fmpy.platform) in files:
            findings += _check_dynamically(description, files, time_limit)
    return ranked(findings)


def _check_dynamically(description: Any, files: dict[str, bytes], limit: float) -> list[Finding]:
    elements = {Kind.COSIMULATION: description.coSimulation, Kind.EXCHANGE: description.modelExchange}
    offered = {kind: element for kind, element in elements.items() if element is not None}
    single = any(element.canBeInstantiatedOnlyOncePerProcess for element in offered.values())
    jobs = [f"{kind.name}:{check}" for kind in offered for check in CHECKS if not single or check not in SEVERAL]
    with TemporaryDirectory(prefix="flexfmu-validate-", ignore_cleanup_errors=True) as home:
        folder = Path(home) / "fmu"
        _unpack(files, folder)
        reported = check_in_child(folder, jobs, not single, limit)
    found = {}
    for kind, element in offered.items():
        found[kind.value] = reported[kind.name]
        if element.needsExecutionTool and any(finding.check == "instantiation" for finding in found[kind.value]):
            found[kind.value] = [_no_tool(kind.value)]
    return _merged(found)


def _unpack(files: dict[str, bytes], folder: Path) -> None:
    """Write the files that an FMU may need to run."""
    (folder / "resources").mkdir(parents=True)
    for name, content in files.items():
        path = PurePosixPath(name.replace("\\", "/"))
        if not path.is_absolute() and ".." not in path.parts and path.parts[0] != "sources":
            target = folder / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)


def _no_tool(interface: str) -> Finding:
    message = f"for {interface} the FMU needs its own tool (needsExecutionTool) and makes no instance here"
    return Finding("instantiation", message, "run this where the tool is", Severity.NOTE)


def _merged(found: dict[str, list[Finding]]) -> list[Finding]:
    """Findings of all interfaces: what both show once, the rest with the interface's name."""
    common = set.intersection(*(set(findings) for findings in found.values()))
    return [
        finding
        if finding in common or len(found) == 1 or finding.check == "interfaces"
        else replace(finding, message=f"{name}: {finding.message}")
        for name, findings in found.items()
        for finding in findings
    ]


def _read(path: Path) -> tuple[list[zipfile.ZipInfo], dict[str, bytes], list[str]]:
    """Directory and content of the archive, path inside → bytes, and paths whose own header says that they are encrypted.

    Every entry is read, so its checksum is checked.
    """
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
            entries = archive.infolist()
            files = {entry.filename: archive.read(entry) for entry in entries if not entry.is_dir()}
            encrypted = [entry.filename for entry in entries if content[entry.header_offset + _FLAGS] & _ENCRYPTED]
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise ArchiveError(f"{path} is no intact FMU (zip archive): {error}; build it again") from error
    if "modelDescription.xml" not in files:
        nested = next((name for name in files if name.endswith("/modelDescription.xml")), None)
        where = f": it is at {nested}, pack the content of that folder" if nested else ""
        other = next((name for name in files if name.lower() == "modeldescription.xml"), None)
        where = f": it is called {other}, rename it" if other else where
        raise ArchiveError(f"{path} is a zip archive but no FMU: modelDescription.xml is missing{where}")
    return entries, files, encrypted
