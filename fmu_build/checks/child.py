"""A short life of an FMU in a process of its own; what it finds goes to a file, line by line, as it is found.

python -m flexfmu.fmu_build.checks.child PARENT FOLDER REPORT CALL_LIMIT PACE KIND:CHECK [KIND:CHECK...]
"""

from __future__ import annotations

import ctypes
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

from fmpy.model_description import read_model_description

from flexfmu.fmu_build.checks.catalogue import CHECKS
from flexfmu.fmu_build.checks.fmu import FmuUnderTest, Kind, OnlyOnceError
from flexfmu.fmu_build.checks.instance import Watch, announce
from flexfmu.fmu_build.checks.life import Check, disturbances, surroundings
from flexfmu.fmu_build.finding import Finding, Severity

LOOK = 0.1
"""How often the watcher looks [s]."""


def main() -> None:
    """Run the checks that the command line names."""
    parent, folder, report, limit, pace, *jobs = sys.argv[1:]
    with Path(report).open("a", encoding="utf-8", buffering=1) as file:
        watched = (file, float(limit), Path(folder).parent, int(parent))
        threading.Thread(target=_watch, args=watched, daemon=True).start()
        description = read_model_description(folder, validate=False)
        fmus = {kind.name: FmuUnderTest(description, Path(folder), kind, float(pace)) for kind in Kind}
        before = surroundings()
        for job in jobs:
            kind, name = job.split(":")
            announce("")
            _say(file, begin=job)
            for finding in _findings(name, CHECKS[name], fmus[kind], before):
                _say(file, finding=asdict(finding))
            _say(file, pace=fmus[kind].pace)
        _say(file, end=True)


def _say(file: TextIO, **line: Any) -> None:
    file.write(json.dumps(line) + "\n")


def _watch(file: TextIO, limit: float, home: Path, parent: int) -> None:
    """End this process and all that it has started when a call doesn't return, or when nobody waits for it any more."""
    while True:
        time.sleep(LOOK)
        call, since = Watch.call, Watch.since
        orphaned = os.name == "posix" and os.getppid() != parent
        if orphaned:
            shutil.rmtree(home, ignore_errors=True)
        if call and time.monotonic() - since > limit:
            _say(file, hang=call)
            orphaned = True
        if orphaned:
            if os.name == "posix":
                os.killpg(0, signal.SIGKILL)
            os._exit(1)


def _findings(name: str, check: Check, fmu: FmuUnderTest, before: dict[str, Any]) -> Iterator[Finding]:
    """What a check finds, failed FMI calls and what it did to the process included."""
    printed, folder = _printed(), Path.cwd()
    try:
        yield from check(fmu)
    except OnlyOnceError:
        return
    except Exception as error:  # any failed FMI call is a finding, not the end of the validation
        logged = f" ({'; '.join(dict.fromkeys(fmu.messages[-2:]))})" if fmu.messages else ""
        severity = Severity.WARNING if name == "calls" else Severity.ERROR
        yield Finding(name, " ".join(f"{error}{logged}".split()), severity=severity)
    finally:
        fmu.messages.clear()
        yield from disturbances(before, surroundings())
        yield from _new_output(printed)
        os.chdir(folder)
        yield from _new_files()


def _printed() -> int:
    """Bytes on standard output so far."""
    ctypes.CDLL(None).fflush(None)
    return os.fstat(1).st_size


def _new_output(before: int) -> Iterator[Finding]:
    """A finding about what an FMU prints."""
    now = _printed()
    if now > before:
        text = os.pread(1, min(now - before, 200), before).decode(errors="replace").strip().splitlines()
        message = "the FMU prints to standard output" + (f": {text[0]!r}" if text else "")
        yield Finding(
            "process", message, "log through the callback: the importing tool's output is its own", Severity.WARNING
        )


def _new_files() -> Iterator[Finding]:
    """A finding about files that an FMU leaves in the working directory, which is empty at the start."""
    for path in sorted(Path.cwd().iterdir()):
        yield Finding(
            "process",
            f"{path.name} is left in the working directory",
            "write where the importing tool says, or nowhere",
            Severity.WARNING,
            path.name,
        )
        shutil.rmtree(path) if path.is_dir() else path.unlink()


if __name__ == "__main__":
    main()
