"""Runs checks in worker processes; after a crash or hang, a new worker continues with the next check."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from flexfmu.fmu_build.temporary import temporary_folder
from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.instance import TRY

CALL_SHARE = 0.2
"""Share of the time limit that one FMI call may take."""

MOST_HANGS = 2
"""Number of hanging calls after which the remaining checks of an interface are skipped."""

LOOK = 0.02
"""Period at which the end of a worker is polled [s]."""

_INSTANTIATION = "instantiation"

_AS_MANY = "a process may make as many as it wants, unless canBeInstantiatedOnlyOncePerProcess"


@dataclass
class _Outcome:
    """Report of a worker.

    Attributes:
        begun: the last check begun, ``KIND:CHECK``.
        found: pairs of interface and finding.
        step_seconds: wall time of a communication step [s]; 0 if unknown.
        problem: crash, hang or timeout as a finding; None if the worker ended normally.
        hangs: whether an FMI call hangs.
        again: whether the last check must be repeated in a new process.
    """

    begun: str = ""
    found: list[tuple[str, Finding]] = field(default_factory=list)
    step_seconds: float = 0.0
    problem: Finding | None = None
    hangs: bool = False
    again: bool = False


def run_checks(folder: Path, jobs: Sequence[str], together: bool, limit: float) -> dict[str, list[Finding]]:
    """Run the checks in worker processes; return the findings by interface, including crashes and hangs.

    Args:
        folder: folder of the extracted FMU.
        jobs: checks as ``KIND:CHECK``, in order.
        together: whether one process may run several checks.
        limit: time limit of all checks [s].

    Raises:
        RuntimeError: a worker fails before its first check.
    """
    end = monotonic() + limit
    findings: dict[str, list[Finding]] = {job.split(":")[0]: [] for job in jobs}
    remaining, step_seconds, hangs = list(jobs), 0.0, Counter[str]()
    while remaining:
        if monotonic() > end:
            _add(
                findings,
                remaining[0].split(":")[0],
                _not_checked(remaining, f"the time limit of {limit:.3g} s is over"),
            )
            break
        # one process for all remaining checks, or for the next one
        outcome = _run(
            folder, remaining if together else remaining[:1], step_seconds, end - monotonic(), CALL_SHARE * limit
        )
        step_seconds = outcome.step_seconds or step_seconds
        for kind, finding in outcome.found:
            _add(findings, kind, finding)
        # a crash or a hang is a finding of the check that was running
        kind = outcome.begun.split(":")[0]
        if outcome.problem is not None:
            _add(findings, kind, outcome.problem)
            hangs[kind] += outcome.hangs
        # continue with the next check
        remaining = remaining[remaining.index(outcome.begun) + (not outcome.again) :]
        if any(
            finding.check == _INSTANTIATION for finding in findings[kind]
        ):  # without an instance no other check can run
            remaining = [job for job in remaining if not job.startswith(kind)]
        if hangs[kind] == MOST_HANGS and (rest := [job for job in remaining if job.startswith(kind)]):
            _add(findings, kind, _not_checked(rest, f"{MOST_HANGS} calls did not return"))
            remaining = [job for job in remaining if job not in rest]
    return findings


def _add(findings: dict[str, list[Finding]], kind: str, finding: Finding) -> None:
    """Add a finding, unless instantiation has failed or another finding already reports the limited number of instances."""
    instanceless = any(known.check == _INSTANTIATION for known in findings[kind])
    if not instanceless and not any(finding.remedy == _AS_MANY == known.remedy for known in findings[kind]):
        findings[kind].append(finding)


def _run(folder: Path, jobs: list[str], step_seconds: float, timeout: float, call_limit: float) -> _Outcome:
    """Run a worker and return its report.

    Raises:
        RuntimeError: the worker fails before its first check.
    """
    with temporary_folder("validate", folder.parent) as home:
        # run the process and read its report
        report = Path(home) / "report"
        module = "flexfmu.fmu_build.validation.worker"
        numbers = [repr(call_limit), repr(step_seconds)]
        command = [sys.executable, "-m", module, str(os.getpid()), str(folder), str(report), *numbers, *jobs]
        status, last = _end_of(command, Path(home), timeout)
        outcome, lines = _Outcome(begun=jobs[0]), list(_lines(report))
    if not lines and status:
        raise RuntimeError(f"the process that checks FMUs ends with status {status} before it begins: {last}")
    # evaluate the report line by line
    before = 0
    for line in lines:
        outcome.step_seconds = line.get("step_seconds", outcome.step_seconds)
        if "begin" in line:
            outcome.begun, before = line["begin"], len(outcome.found)
        if "finding" in line:
            outcome.found.append((outcome.begun.split(":")[0], _finding(line["finding"])))
        if "exhausted" in line:
            # the FMU limits its instances: repeat the check in a new process
            kind, check = outcome.begun.split(":")
            outcome.again = outcome.begun != jobs[0]
            del outcome.found[before if outcome.again else len(outcome.found) :]
            outcome.found.append((kind, Finding("instances", line["exhausted"], _AS_MANY, Severity.WARNING)))
            if not outcome.again:
                message = f"{check} not finished: it makes more instances than the FMU allows in a process"
                outcome.found.append((kind, Finding(check, message, severity=Severity.NOTE)))
    # no final line: the worker has crashed or hangs
    if not any("end" in line for line in lines):
        hang = next((line["hang"] for line in lines if "hang" in line), None)
        outcome.hangs = hang is not None
        outcome.problem = _problem(outcome.begun.split(":")[1], status, last, hang, timeout, call_limit)
    elif status:
        outcome.problem = _problem("memory", status, last, None, timeout, call_limit)
    return outcome


def _problem(check: str, status: int | None, last: str, hang: str | None, timeout: float, call_limit: float) -> Finding:
    """Finding about a crash, a hang or a timeout.

    Args:
        check: the check that was running.
        status: exit status, negative for a signal; None if the worker was still running.
        last: last line on standard error.
        hang: name of the hanging FMI call, if any.
        timeout: time limit of the worker [s].
        call_limit: time limit of one call [s].
    """
    severity = Severity.WARNING if check == "calls" else Severity.ERROR
    # a hanging call, or the time limit of the worker
    if hang is not None:
        message = f"{hang} did not return within {call_limit:.3g} s"
        return Finding(check, message, "every FMI call has to return; --time-limit gives more time", severity)
    if status is None:
        message = f"not finished when the time limit was over, {timeout:.3g} s after its process had begun"
        return Finding(check, message, "--time-limit gives more", Severity.NOTE)
    # a call of exit, or a crash
    if status == 0:
        return Finding(check, "the FMU ended the process that ran it", "an FMU must not call exit", severity)
    how = f"signal {-status}" if status < 0 else f"exit status {status}"
    message = f"the process that ran the FMU ended with {how}: {last}"
    return Finding(check, message, "an FMU must never end its process", severity)


def _end_of(command: list[str], folder: Path, timeout: float) -> tuple[int | None, str]:
    """Run a command and kill its process group; return its exit status (None on timeout) and its last line."""
    (folder / "work").mkdir()
    with (folder / "stdout").open("w+b") as stdout, (folder / "stderr").open("w+b") as stderr:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stderr,
            cwd=folder / "work",
            start_new_session=os.name == "posix",
        )
        try:
            # kill the whole group, including processes that the FMU has started
            status = _wait(process, max(timeout, 1.0))
        finally:
            _kill(process)
        stderr.seek(0)
        lines = stderr.read().decode(errors="replace").strip().splitlines()
    # the last message, and the last announcement
    last = next((line for line in reversed(lines) if not line.startswith(TRY)), "no message")
    tried = next((line.removeprefix(TRY) for line in reversed(lines) if line.startswith(TRY)), "")
    return status, f"{last} ({tried})" if tried else last


def _wait(process: subprocess.Popen[bytes], timeout: float) -> int | None:
    """Exit status, None on timeout; on POSIX the process stays a zombie, so that its id is not reused."""
    if os.name != "posix":
        with suppress(subprocess.TimeoutExpired):
            return process.wait(timeout)
        return None
    # poll without reaping the process, which would free its id
    end = monotonic() + timeout
    while (ended := os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is None:
        if monotonic() > end:
            return None
        sleep(LOOK)
    return ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill the process and its group."""
    if os.name == "posix":
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()


def _lines(report: Path) -> Iterator[dict[str, Any]]:
    """Yield the complete lines of the report; a crash may have cut off the last one."""
    if report.exists():
        for line in report.read_text(encoding="utf-8").splitlines(keepends=True):
            if line.endswith("\n"):
                yield json.loads(line)


def _finding(line: dict[str, Any]) -> Finding:
    return Finding(**(line | {"severity": Severity(line["severity"]), "others": tuple(line["others"])}))


def _not_checked(jobs: list[str], why: str) -> Finding:
    names = ", ".join(dict.fromkeys(job.split(":")[1] for job in jobs))
    message = f"{names} not checked: {why}"
    return Finding("simulation", message, "--time-limit gives more", Severity.NOTE)
