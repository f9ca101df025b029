"""Runs the checks that may crash or hang in child processes, and goes on after the one that did."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

from flexfmu.fmu_build.checks.fmu import Kind
from flexfmu.fmu_build.finding import Finding, Severity

_INSTANTIATION = "instantiation"


def check_in_child(path: Path, kind: Kind, names: Sequence[str], timeout: float) -> list[Finding]:
    """Findings of the checks, also of those that end or block their process.

    Args:
        path: the FMU.
        kind: interface under test.
        names: checks, in their order.
        timeout: longest time for all of them [s].
    """
    end = monotonic() + timeout
    findings: list[Finding] = []
    remaining = list(names)
    while remaining:
        begun, found, problem = _run(path, kind, remaining, end - monotonic())
        findings += found
        if problem is None:
            break
        findings.append(replace(problem, check=begun))
        remaining = remaining[remaining.index(begun) + 1 :]
        if monotonic() > end and remaining:
            findings.append(_not_checked(remaining, timeout))
            break
        if begun == _INSTANTIATION:
            break
    return findings


def _run(path: Path, kind: Kind, names: list[str], timeout: float) -> tuple[str, list[Finding], Finding | None]:
    """Run a child: the check it got to, what it found, and how it ended if not as it should."""
    with TemporaryDirectory(prefix="flexfmu-validate-") as home:
        report = Path(home) / "report"
        module = "flexfmu.fmu_build.checks.child"
        command = [sys.executable, "-m", module, str(path.absolute()), str(report), kind.name, *names]
        problem = _end_of(command, Path(home), timeout)
        lines = [json.loads(line) for line in _lines(report)]
    begun = next((line["begin"] for line in reversed(lines) if "begin" in line), names[0])
    found = [_finding(line) for line in lines if "check" in line]
    if problem is None and not any("end" in line for line in lines):
        problem = Finding("", "the FMU ended the process that ran it", "an FMU must not call exit")
    if any(finding.check == _INSTANTIATION for finding in found):
        return begun, [finding for finding in found if finding.check == _INSTANTIATION], None
    return begun, found, problem


def _end_of(command: list[str], folder: Path, timeout: float) -> Finding | None:
    """What is wrong with the way in which the process ends; all that it started ends with it."""
    errors = folder / "stderr"
    with errors.open("wb") as stderr:
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=stderr, cwd=folder, start_new_session=os.name == "posix"
        )
        try:
            status = process.wait(max(timeout, 1.0))
        except subprocess.TimeoutExpired:
            _kill(process)
            return Finding("", f"the FMU did not finish within {timeout:.0f} s", "every FMI call has to return")
    if status == 0:
        return None
    how = f"signal {-status}" if status < 0 else f"exit status {status}"
    last = (errors.read_text(errors="replace").strip().splitlines() or ["no message"])[-1]
    return Finding("", f"the process that ran the FMU ended with {how}: {last}", "an FMU must never end its process")


def _kill(process: subprocess.Popen[bytes]) -> None:
    if os.name == "posix":
        os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()


def _lines(report: Path) -> Iterator[str]:
    """Complete lines of the report; a crash may have cut the last one."""
    if report.exists():
        yield from (
            line for line in report.read_text(encoding="utf-8").splitlines(keepends=True) if line.endswith("\n")
        )


def _finding(line: dict[str, str]) -> Finding:
    return Finding(**(line | {"severity": Severity(line["severity"])}))  # type: ignore[arg-type]


def _not_checked(names: list[str], timeout: float) -> Finding:
    return Finding(
        "simulation", f"{', '.join(names)} not checked: {timeout:.0f} s are over", "give more time", Severity.NOTE
    )
