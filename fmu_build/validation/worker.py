"""Runs checks of an FMU in a separate process and writes each finding as a line of JSON to a report file.

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
"""Period of the watchdog thread [s]."""


def main() -> None:
    """Run the checks that the command line names."""
    parent, folder, report, limit, pace, *jobs = sys.argv[1:]
    with Path(report).open("a", encoding="utf-8", buffering=1) as file:
        # watchdog thread for FMI calls that hang
        watched = (file, float(limit), Path(folder).parent, int(parent))
        threading.Thread(target=_watch, args=watched, daemon=True).start()
        # the FMU, and the state of the process before the first check
        description = read_model_description(folder, validate=False)
        fmus = {kind.name: FmuUnderTest(description, Path(folder), kind, float(pace)) for kind in InterfaceType}
        standard = [os.dup(number) for number in range(3)]
        before = surroundings(Path(folder))
        # one check after the other; findings are in the file before the next check may crash
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
    """Kill this process and its children when an FMI call hangs or the supervisor has ended."""
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
    """Yield the findings of a check, of failed FMI calls and of changes to the process.

    Args:
        name: name of the check.
        check: the check.
        fmu: the FMU.
        before: state of the process before the first check, see `surroundings`.
        standard: copies of standard input, output and error.
    """
    printed, folder = printed_bytes(), Path.cwd()
    try:
        yield from check(fmu)
    except OnlyOnceError:
        return
    except NoMoreInstancesError as error:
        raise NoMoreInstancesError(_with_messages(error, fmu)) from error
    except Exception as error:  # a failed FMI call is a finding and doesn't end the validation
        severity = Severity.WARNING if name == "calls" else Severity.ERROR
        what, remedy = _explained(error)
        yield Finding(name, _with_messages(what, fmu), remedy, severity)
    finally:
        # changes to the process
        fmu.messages.clear()
        yield from closed_streams(standard)
        yield from disturbances(before, surroundings(fmu.folder))
        yield from printed_text(printed)
        os.chdir(folder)
        yield from files_left()


def _with_messages(error: Exception | str, fmu: FmuUnderTest) -> str:
    """The error in one line, followed by the FMU's last two log messages."""
    logged = f" ({'; '.join(dict.fromkeys(fmu.messages[-2:]))})" if fmu.messages else ""
    return " ".join(f"{error}{logged}".split())


_STATUS = {
    2: ("fmi2Discard", "give the value, or return fmi2Error where it can't be had"),
    3: ("fmi2Error", "the call is legal here: carry it out, and log what goes wrong"),
    4: ("fmi2Fatal", "keep fmi2Fatal for what no instance in the process survives"),
    5: ("fmi2Pending", "return fmi2Pending from fmi2DoStep alone, and claim canRunAsynchronuously"),
}
"""fmi2Status → its name, and the remedy where the call should succeed."""


def _explained(error: Exception) -> tuple[str, str]:
    """Description of an exception in the standard's terms, and the remedy."""
    if isinstance(error, FMICallException):
        name, remedy = _STATUS.get(
            error.status, (f"the status {error.status}, which there is not", "return a fmi2Status")
        )
        return f"{error.function} returns {name}", remedy
    return str(error), getattr(error, "remedy", "the call is legal here: carry it out")


if __name__ == "__main__":
    main()
