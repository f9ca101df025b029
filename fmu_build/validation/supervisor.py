"""Runs checks in worker processes; after a crash or hang, a new worker continues with the next check."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from time import monotonic, sleep
from typing import Any, cast

from flexfmu.fmu_build.guard import AVAILABLE, guarded
from flexfmu.fmu_build.temporary import temporary_folder
from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.instance import TRY

CALL_SHARE = 0.2
"""Share of the time limit that one FMI call may take."""

MOST_HANGS = 2
"""Number of hanging calls after which the remaining checks of an interface are skipped."""

LOOK = 0.02
"""Period at which the end of a worker is polled [s]."""

GRACE = 10.0
"""Time that a guard may take to end what an FMU has started [s]."""

_INSTANTIATION = "instantiation"

_AS_MANY = "a process may make as many as it wants, unless canBeInstantiatedOnlyOncePerProcess"


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
    end, call_limit = monotonic() + limit, CALL_SHARE * limit
    findings: dict[str, list[Finding]] = {job.split(":")[0]: [] for job in jobs}
    remaining, step_seconds, hangs = list(jobs), 0.0, Counter[str]()
    repeated, suspect = set[tuple[object, ...]](), cast("tuple[str, Finding] | None", None)
    while remaining:
        timeout = end - monotonic()
        if timeout < 0.0:
            _add(findings, remaining[0], _not_checked(remaining, f"the time limit of {limit:.3g} s is over"))
            break
        # one process for all remaining checks, or for the next one
        batch = remaining if together else remaining[:1]
        lines, status, last, call = _run(folder, batch, step_seconds, timeout, call_limit)
        begun, before, again = batch[0], 0, False
        found: list[tuple[str, Finding]] = []
        for line in lines:
            step_seconds = line.get("step_seconds") or step_seconds
            if "begin" in line:
                begun, before = line["begin"], len(found)
            if "finding" in line:
                fields = line["finding"]
                finding = Finding(
                    **(fields | {"severity": Severity(fields["severity"]), "others": tuple(fields["others"])})
                )
                found.append((begun, finding))
            if "exhausted" in line:
                # the FMU limits its instances: repeat the check in a new process
                again = begun != batch[0]
                del found[before if again else len(found) :]
                found.append((begun, Finding(line["exhausted"], _AS_MANY, Severity.WARNING, check="instances")))
                if not again:
                    check = begun.split(":")[1]
                    message = f"{check} not finished: it makes more instances than the FMU allows in a process"
                    found.append((begun, Finding(message, severity=Severity.NOTE, check=check)))
        # a crash or a hang is a finding of the check that was running; without a final line the worker has crashed or hangs
        kind, check = begun.split(":")
        has_ended = any("end" in line for line in lines)
        hang = next((line["hang"] for line in lines if "hang" in line), None)
        suspected, suspect = suspect, None
        if status or not has_ended:
            check = "memory" if has_ended else check
            problem = _problem(check, status, call, last, hang, timeout, call_limit)
            hangs[kind] += hang is not None
            # a crash is the FMU's where a new process repeats it at once; one that wanders may be anybody's
            crash = (kind, status, call)
            if status is None or hang is not None or crash in repeated or (suspected and suspected[0] == begun):
                found.append((begun, problem))
                repeated.add(crash)
            else:
                again, suspect = True, (begun, problem)
                del found[before:]
        if suspected and not (begun == suspected[0] and (status or not has_ended)):
            message = f"{suspected[1].message}; not so where a new process repeats it"
            remedy = "what came before may be to blame: run the FMU under valgrind"
            found.append((suspected[0], replace(suspected[1], message=message, remedy=remedy, severity=Severity.NOTE)))
        for job, finding in found:
            _add(findings, job, finding)
        # continue with the next check; without an instance no other check can run
        remaining = remaining[remaining.index(begun) + (not again) :]
        if any(finding.check == _INSTANTIATION for finding in findings[kind]):
            remaining = [job for job in remaining if not job.startswith(kind)]
        if hangs[kind] == MOST_HANGS and (rest := [job for job in remaining if job.startswith(kind)]):
            _add(findings, kind, _not_checked(rest, f"{MOST_HANGS} calls did not return"))
            remaining = [job for job in remaining if job not in rest]
    return findings


def _add(findings: dict[str, list[Finding]], job: str, finding: Finding) -> None:
    """Add a finding, unless instantiation has failed or another finding already reports the limited number of instances."""
    known = findings[job.split(":")[0]]
    is_repeated = any(finding.remedy == _AS_MANY == each.remedy for each in known)
    if not is_repeated and not any(each.check == _INSTANTIATION for each in known):
        known.append(finding)


def _run(
    folder: Path, jobs: list[str], step_seconds: float, timeout: float, call_limit: float
) -> tuple[list[dict[str, Any]], int | None, str, str]:
    """Run a worker; return the lines of its report, its exit status (None on timeout), its last words and the last FMI call.

    Raises:
        RuntimeError: the worker fails before its first check.
    """
    with temporary_folder("validate", folder.parent) as home:
        report, record = Path(home) / "report", Path(home) / "call"
        module = "flexfmu.fmu_build.validation.worker"
        numbers = [repr(call_limit), repr(step_seconds)]
        command = [sys.executable, "-m", module, str(folder), str(report), str(record), *numbers, *jobs]
        status, last = _end_of(command, Path(home), timeout)
        # a crash may have cut off the last line
        text = report.read_text(encoding="utf-8") if report.exists() else ""
        lines = [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
        call = record.read_text().strip("\0 ") if record.exists() else ""
    if not lines and status:
        raise RuntimeError(f"the process that checks FMUs ends with status {status} before it begins: {last}")
    return lines, status, last, call


def _problem(
    check: str, status: int | None, call: str, last: str, hang: str | None, timeout: float, call_limit: float
) -> Finding:
    """Finding about a crash, a hang or a timeout.

    Args:
        check: the check that was running.
        status: exit status, negative for a signal; None if the worker was still running.
        call: name of the FMI call in which the process ended; empty if it ended between calls.
        last: last line on standard error.
        hang: name of the hanging FMI call, if any.
        timeout: time limit of the worker [s].
        call_limit: time limit of one call [s].
    """
    severity, where = Severity.WARNING if check == "calls" else Severity.ERROR, f" in {call}" if call else ""
    # a hanging call, or the time limit of the worker
    if hang is not None:
        message = f"{hang} did not return within {call_limit:.3g} s"
        return Finding(message, "every FMI call has to return; --time-limit gives more time", severity, check=check)
    if status is None:
        message = f"not finished when the time limit was over, {timeout:.3g} s after its process had begun"
        return Finding(message, "--time-limit gives more", Severity.NOTE, check=check)
    # a call of exit, or a crash
    if status == 0:
        message = f"the FMU ended the process that ran it{where}"
        return Finding(message, "an FMU must not call exit", severity, check=check)
    how = f"signal {-status}" if status < 0 else f"exit status {status}"
    message = f"the process that ran the FMU ended with {how}{where}: {last}"
    return Finding(message, "an FMU must never end its process", severity, check=check)


def _end_of(command: list[str], folder: Path, timeout: float) -> tuple[int | None, str]:
    """Run a command, and end what it has started; return its exit status (None on timeout) and its last line."""
    (folder / "work").mkdir()
    with (folder / "stdout").open("w+b") as stdout, (folder / "stderr").open("w+b") as stderr:
        parent = os.getpid()
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stderr,
            cwd=folder / "work",
            start_new_session=os.name == "posix",
            preexec_fn=(lambda: guarded(parent)) if AVAILABLE else None,
        )
        try:
            status = _wait(process, max(timeout, 1.0))
        finally:
            # end what the FMU has started too, where there is no guard at least what is in the worker's group
            if AVAILABLE:
                process.send_signal(signal.SIGHUP)
                with suppress(subprocess.TimeoutExpired):
                    process.wait(GRACE)
            elif os.name == "posix":
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
            process.kill()
            process.wait()
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


def _not_checked(jobs: list[str], why: str) -> Finding:
    names = ", ".join(dict.fromkeys(job.split(":")[1] for job in jobs))
    message = f"{names} not checked: {why}"
    return Finding(message, "--time-limit gives more", Severity.NOTE, check="simulation")
