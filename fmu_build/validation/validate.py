"""Validation of an FMU: static checks of archive, description and binaries, then dynamic checks in worker processes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from flexfmu.fmu_build.temporary import temporary_folder
from flexfmu.fmu_build.validation.archive import check_archive, check_entries, check_sources, read_archive, unpack
from flexfmu.fmu_build.validation.binaries import check_binaries, library_name
from flexfmu.fmu_build.validation.description import fmi_version, interfaces, read_description
from flexfmu.fmu_build.validation.finding import Finding, Severity, named, ranked
from flexfmu.fmu_build.validation.fmi3 import in_fmi3
from flexfmu.fmu_build.validation.fmu import InterfaceType
from flexfmu.fmu_build.validation.supervisor import run_checks
from flexfmu.fmu_build.validation.worker import CHECKS, EXCHANGE_ONLY, SLAVE_ONLY

TIME_LIMIT = 120.0
"""Time limit of the dynamic checks [s]; the paper's scene needs a few seconds."""


def validate_fmu(path: Path, time_limit: float = TIME_LIMIT, run: bool = True) -> list[Finding]:
    """Check any FMU 2.0 or 3.0, for co-simulation, model exchange or both.

    Static checks: archive, model description (by fmpy and by further rules), names, exports and dependencies of the
    binaries. Dynamic checks: those of `flexfmu.fmu_build.validation.worker`. They run in worker processes, so that a
    crash is a finding; the workers end with this process.
    Of an FMU 3.0 its scalars are tried (see `flexfmu.fmu_build.validation.fmi3`).

    Args:
        path: the FMU file.
        time_limit: time limit of the dynamic checks [s]; one FMI call may take a fifth of it.
        run: False runs the static checks only.

    Returns:
        Findings, equal ones merged, the worst first; empty if there are none.

    Raises:
        ArchiveError: the file is missing, no zip archive, damaged, or has no modelDescription.xml.
    """
    entries, files, encrypted = read_archive(path)
    version = fmi_version(files["modelDescription.xml"])
    if version != "2.0" and not version.startswith("3."):
        message = f"fmiVersion is {version or 'missing'}: FMUs of versions 2.0 and 3.0 are checked"
        return [Finding(message, "export the model as FMI 2.0", check="model description", section="2.2.1")]
    description, findings = read_description(path, files["modelDescription.xml"])
    findings += [*named("archive", check_entries(entries, encrypted)), *named("archive", check_archive(files))]
    # binaries, then dynamic checks
    if description is not None and interfaces(description):
        findings += named("binary", check_binaries(description, files))
        findings += named("sources", check_sources(description, path))
        if run and library_name(description) in files:
            findings += _check_dynamically(description, path, time_limit)
    return ranked(findings if version == "2.0" else map(in_fmi3, findings))


def _check_dynamically(description: Any, fmu: Path, limit: float) -> list[Finding]:
    # every check for every interface; where a process may make one instance, a check that needs several finds nothing
    elements = {InterfaceType.COSIMULATION: description.coSimulation, InterfaceType.EXCHANGE: description.modelExchange}
    offered = {kind: element for kind, element in elements.items() if element is not None}
    single = any(element.canBeInstantiatedOnlyOncePerProcess for element in offered.values())
    others = {InterfaceType.COSIMULATION: EXCHANGE_ONLY, InterfaceType.EXCHANGE: SLAVE_ONLY}
    jobs = [f"{kind.name}:{check}" for kind in offered for check in CHECKS if check not in others[kind]]
    with temporary_folder("validate") as home:
        folder = Path(home) / "fmu"
        unpack(fmu, folder)
        reported = run_checks(folder, jobs, not single, limit)
    # a failed instantiation is no defect if the FMU needs its own tool
    found = {}
    for kind, element in offered.items():
        found[kind.value] = reported[kind.name]
        if element.needsExecutionTool and any(finding.check == "instantiation" for finding in found[kind.value]):
            message = f"for {kind.value} the FMU needs its own tool (needsExecutionTool) and makes no instance here"
            found[kind.value] = [Finding(message, "run this where the tool is", Severity.NOTE, check="instantiation")]
    return _merged(found)


def _merged(found: dict[str, list[Finding]]) -> list[Finding]:
    """Findings of all interfaces; the message names the interface unless both have the finding."""
    common = set.intersection(*(set(findings) for findings in found.values()))
    return [
        finding
        if finding in common or len(found) == 1 or finding.check == "interfaces"
        else replace(finding, message=f"{name}: {finding.message}")
        for name, findings in found.items()
        for finding in findings
    ]
