"""Runs checks of an FMU in a process of its own and writes what they find to a file, line by line.

python -m flexfmu.fmu_build.validation.worker PARENT FOLDER REPORT CALL_LIMIT PACE KIND:CHECK [KIND:CHECK...]
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

from fmpy.fmi1 import FMICallException
from fmpy.model_description import read_model_description

from flexfmu.fmu_build.validation.catalogue import CHECKS, Check
from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType, NoMoreInstancesError, OnlyOnceError
from flexfmu.fmu_build.validation.library import Watch, announce
from flexfmu.fmu_build.validation.process_state import (
    closed_streams,
    disturbances,
    files_left,
    printed_bytes,
    printed_text,
    surroundings,
)

LOOK = 0.1
"""How often the watcher looks [s]."""


def main() -> None:
    """Run the checks that the command line names."""
    parent, folder, report, limit, pace, *jobs = sys.argv[1:]
    with Path(report).open("a", encoding="utf-8", buffering=1) as file:
        # a thread watches for calls that hang
        watched = (file, float(limit), Path(folder).parent, int(parent))
        threading.Thread(target=_watch, args=watched, daemon=True).start()
        # the FMU and the process as they are before the first check
        description = read_model_description(folder, validate=False)
        fmus = {kind.name: FmuUnderTest(description, Path(folder), kind, float(pace)) for kind in InterfaceType}
        standard = [os.dup(number) for number in range(3)]
        before = surroundings(Path(folder))
        # check by check; what is found is on file before the next one may crash
        for job in jobs:
            kind, name = job.split(":")
            announce("")
            _report(file, begin=job)
            try:
                for finding in _findings(name, CHECKS[name], fmus[kind], before, standard):
                    _report(file, finding=asdict(finding))
            except NoMoreInstancesError as error:
                _report(file, exhausted=str(error))
                break
            _report(file, pace=fmus[kind].pace)
        _report(file, end=True)


def _report(file: TextIO, **line: Any) -> None:
    file.write(json.dumps(line) + "\n")


def _watch(file: TextIO, limit: float, home: Path, parent: int) -> None:
    """End this process and all that it has started when a call doesn't return, or when the supervisor has ended."""
    while True:
        time.sleep(LOOK)
        call, since = Watch.call, Watch.since
        orphaned = os.name == "posix" and os.getppid() != parent
        if orphaned:
            shutil.rmtree(home, ignore_errors=True)
        if call and time.monotonic() - since > limit:
            _report(file, hang=call)
            orphaned = True
        if orphaned:
            if os.name == "posix":
                os.killpg(0, signal.SIGKILL)
            os._exit(1)


def _findings(
    name: str, check: Check, fmu: FmuUnderTest, before: dict[str, Any], standard: list[int]
) -> Iterator[Finding]:
    """What a check finds, failed FMI calls and what it did to the process included.

    Args:
        name: the check's.
        check: what is tried.
        fmu: the FMU.
        before: what the process looked like.
        standard: copies of standard input, output and error.
    """
    printed, folder = printed_bytes(), Path.cwd()
    try:
        yield from check(fmu)
    except OnlyOnceError:
        return
    except NoMoreInstancesError as error:
        raise NoMoreInstancesError(_with_messages(error, fmu)) from error
    except Exception as error:  # any failed FMI call is a finding, not the end of the validation
        severity = Severity.WARNING if name == "calls" else Severity.ERROR
        what, remedy = _explained(error)
        yield Finding(name, _with_messages(what, fmu), remedy, severity)
    finally:
        # what the check has done to the process
        fmu.messages.clear()
        yield from closed_streams(standard)
        yield from disturbances(before, surroundings(fmu.folder))
        yield from printed_text(printed)
        os.chdir(folder)
        yield from files_left()


def _with_messages(error: Exception | str, fmu: FmuUnderTest) -> str:
    """A failure in a line, with what the FMU has logged last."""
    logged = f" ({'; '.join(dict.fromkeys(fmu.messages[-2:]))})" if fmu.messages else ""
    return " ".join(f"{error}{logged}".split())


_STATUS = {
    2: ("fmi2Discard", "give the value, or return fmi2Error where it can't be had"),
    3: ("fmi2Error", "the call is legal here: carry it out, and log what goes wrong"),
    4: ("fmi2Fatal", "keep fmi2Fatal for what no instance in the process survives"),
    5: ("fmi2Pending", "return fmi2Pending from fmi2DoStep alone, and claim canRunAsynchronuously"),
}
"""Status → its name, and what to do where a call ought to succeed."""


def _explained(error: Exception) -> tuple[str, str]:
    """An exception in words of the standard, and the remedy."""
    if isinstance(error, FMICallException):
        name, remedy = _STATUS.get(
            error.status, (f"the status {error.status}, which there is not", "return a fmi2Status")
        )
        return f"{error.function} returns {name}", remedy
    return str(error), getattr(error, "remedy", "the call is legal here: carry it out")


if __name__ == "__main__":
    main()
