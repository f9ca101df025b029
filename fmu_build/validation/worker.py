"""All dynamic checks: runs those of an FMU in a separate process and writes each finding as a line of JSON to a report file.

python -m flexfmu.fmu_build.validation.worker FOLDER REPORT CALL CALL_LIMIT STEP_SECONDS KIND:CHECK [KIND:CHECK...]

Process state that an FMU must not change: locale, rounding, signal handlers, standard streams, files.
"""

from __future__ import annotations

import ctypes
import errno
import json
import locale
import os
import platform
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from mmap import mmap
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from fmpy.fmi1 import FMICallException

from flexfmu.fmu_build.validation import dependencies, derivatives, exchange, lifecycle, replay, steps, values
from flexfmu.fmu_build.validation.finding import Finding, Severity, named
from flexfmu.fmu_build.validation.fmi3 import described
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType, NoMoreInstancesError, OnlyOnceError
from flexfmu.fmu_build.validation.instance import RECORD, Watch, announce

Check = Callable[[FmuUnderTest], Iterator[Finding]]
"""A dynamic check: runs an FMU and yields findings; a failed FMI call may raise fmpy's exception."""

CHECKS: dict[str, Check] = {
    "instantiation": lifecycle.instantiates,
    "guid": lifecycle.refuses_wrong_guid,
    "simulation": lifecycle.outputs_are_finite,
    "repeatability": replay.repeats_itself,
    "resource location": lifecycle.accepts_odd_uris,
    "memory": lifecycle.gives_memory_back,
    "start value": values.starts_are_kept,
    "parameters": values.parameters_are_kept,
    "tunable parameters": values.tunable_parameters_are_taken,
    "initialisation": replay.initializes_alike,
    "start time": lifecycle.starts_at_the_start_time,
    "logging": lifecycle.logs_in_its_categories,
    "several variables": values.one_call_does_what_several_do,
    "reset": replay.repeats_after_reset,
    "reading": replay.reads_leave_the_state_alone,
    "state": replay.replays_saved_states,
    "inputs in the state": replay.brings_inputs_back,
    "serialisation": replay.replays_serialized_state,
    "instances": replay.two_instances_are_independent,
    "rates": derivatives.states_follow_their_derivatives,
    "variable step": steps.halving_the_step_changes_little,
    "time": steps.reports_the_time,
    "last successful time": steps.reports_the_last_successful_time,
    "input derivatives": steps.interpolates_inputs,
    "output derivatives": derivatives.output_derivatives_are_right,
    "directional derivatives": derivatives.directional_derivatives_are_right,
    "derivatives": exchange.derivatives_depend_on_state_alone,
    "states": exchange.states_are_the_variables,
    "integrator steps": exchange.integrator_steps_change_nothing,
    "time events": exchange.time_events_lie_ahead,
    "event indicators": exchange.event_indicators_are_given,
    "dependencies of variables": dependencies.declared_dependencies_hold,
    "initial dependencies": dependencies.initial_dependencies_hold,
    "clocked outputs": dependencies.clocked_outputs_are_up_to_date,
    "interfaces": exchange.interfaces_agree,
    "calls": lifecycle.refuses_illegal_calls,
}
"""Name of the finding → check. A check that doesn't apply to the FMU yields nothing; if the first fails, the others can't run."""

SLAVE_ONLY = ["rates", "variable step", "time", "last successful time", "input derivatives", "output derivatives"]
EXCHANGE_ONLY = ["derivatives", "states", "integrator steps", "time events", "event indicators", "interfaces"]
"""The checks that are for one interface."""

_ROUNDING = {0: "nearest", 0x400: "downwards", 0x800: "upwards", 0xC00: "towards zero"}
"""Return value of fegetround on x86 → name of the rounding mode."""


def surroundings(fmu: Path) -> dict[str, Any]:
    """The process state that an FMU must not change, name → value.

    Args:
        fmu: folder of the extracted FMU.
    """
    resources = (path for path in (fmu / "resources").rglob("*") if path.is_file())
    seen: dict[str, Any] = {
        "working directory": os.getcwd(),
        "locale for numbers": locale.setlocale(locale.LC_NUMERIC),
        "rounding of numbers": float(np.float64(1.0) / np.float64(3.0)) + float(np.float64(-1.0) / np.float64(3.0)),
        "treatment of denormal numbers": bool(np.float64(5e-324) * np.float64(1.0)),
        "resources": {str(path.relative_to(fmu)): path.stat().st_mtime_ns for path in resources},
    }
    # state of the C library: rounding mode, environment, umask
    if os.name == "posix":
        libc = ctypes.CDLL(None)
        seen["rounding of numbers"] = libc.fegetround() if hasattr(libc, "fegetround") else 0
        seen["environment"] = _environment(libc)
        seen["mask of new files"] = os.umask(0)
        os.umask(seen["mask of new files"])
    # on Linux: floating-point traps, signal handlers, open files, threads and child processes
    if sys.platform == "linux":
        seen["floating-point traps"] = ctypes.CDLL("libm.so.6").fegetexcept()
        seen["signal handlers"] = [_handler(libc, number) for number in range(1, signal.SIGRTMIN)]
        seen["blocked signals"] = signal.pthread_sigmask(signal.SIG_BLOCK, ())
        seen["open files"] = len(os.listdir("/proc/self/fd"))
        tasks = list(Path("/proc/self/task").iterdir())
        seen["threads"] = len(tasks)
        seen["child processes"] = sum(len((task / "children").read_text().split()) for task in tasks)
    return seen


def _handler(libc: Any, number: int) -> int:
    """Address of the handler of a signal, the first member of glibc's struct sigaction."""
    action = (ctypes.c_size_t * 32)()
    libc.sigaction(number, None, action)
    return int(action[0])


def _environment(libc: Any) -> dict[str, str]:
    """The environment variables of the C library."""
    pointer = ctypes.POINTER(ctypes.c_char_p).in_dll(libc, "environ")
    entries: list[str] = []
    while bool(pointer) and (entry := pointer[len(entries)]) is not None:
        entries.append(entry.decode(errors="replace"))
    return dict(entry.partition("=")[::2] for entry in entries)


def disturbances(before: dict[str, Any], after: dict[str, Any]) -> Iterator[Finding]:
    """Yield findings about changes of the process state; reported entries are removed from ``before``."""
    for what, old in list(before.items()):
        new = after[what]
        if new == old:
            continue
        del before[what]  # report each change once
        change, whose, remedy = f"changes the {what}", ", which belongs to the importing tool", _RESTORE
        match what:
            case "open files" | "threads" | "child processes" if new < old:
                continue
            case "threads" | "child processes":
                change, remedy = f"leaves {what} running", "end them in fmi2FreeInstance"
            case "open files":
                change, remedy = "leaves files open", "close them"
            case "resources":
                change, whose = f"writes into its resources: {', '.join(_changed(old, new)[:3])}", ""
                remedy = "write elsewhere: they may be read-only, and other instances use them"
            case "environment":
                change, remedy = f"changes the environment: {', '.join(_changed(old, new))}", "leave it alone"
            case "mask of new files":
                change += f" to {new:#05o}"
            case "rounding of numbers" if platform.machine() in ("x86_64", "AMD64"):
                change += f" to {_ROUNDING.get(new, new)}"
            case _ if what not in ("signal handlers", "blocked signals"):
                change += f" to {new}"
        yield Finding(f"the FMU {change}{whose}", remedy, Severity.WARNING)


_RESTORE = "restore it before each FMI call returns"


def _changed(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Names of what is new, missing or different."""
    return sorted(name for name in {*old, *new} if old.get(name) != new.get(name))


def closed_streams(standard: list[int]) -> Iterator[Finding]:
    """Yield a finding for each standard stream that the FMU has closed, and reopen it.

    Args:
        standard: duplicated file descriptors of standard input, output and error.
    """
    names = ("input", "output", "error")
    for number, (name, copy) in enumerate(zip(names, standard, strict=True)):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(copy, number)
            message = f"the FMU closes standard {name}, which belongs to the importing tool"
            yield Finding(message, "leave it open", Severity.WARNING)


def printed_bytes() -> int:
    """Size of the file behind standard output, after a flush [bytes]."""
    ctypes.CDLL(None).fflush(None)
    return os.fstat(1).st_size


LOOK = 0.1
"""Period of the watchdog thread [s]."""


def main() -> None:
    """Run the checks that the command line names."""
    folder, report, call, limit, step_seconds, *jobs = sys.argv[1:]
    with Path(report).open("a", encoding="utf-8", buffering=1) as file, Path(call).open("w+b") as record:
        # the name of the current call, for who looks after a crash
        record.truncate(RECORD)
        Watch.record = mmap(record.fileno(), RECORD)
        # watchdog thread for FMI calls that hang
        watched = (file, float(limit), Path(folder).parent, os.getppid())
        threading.Thread(target=_watch, args=watched, daemon=True).start()
        # the FMU, and the state of the process before the first check
        description = described(Path(folder))
        fmus = {kind.name: FmuUnderTest(description, Path(folder), kind, float(step_seconds)) for kind in InterfaceType}
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
            _report(file, step_seconds=fmus[kind].step_seconds)
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
        yield from named(name, check(fmu))
    except OnlyOnceError:
        return
    except NoMoreInstancesError as error:
        raise NoMoreInstancesError(_with_messages(error, fmu)) from error
    except Exception as error:  # a failed FMI call is a finding and doesn't end the validation
        what, remedy = str(error), getattr(error, "remedy", "the call is legal here: carry it out")
        if isinstance(error, FMICallException):
            status, remedy = _STATUS.get(
                error.status, (f"the status {error.status}, which there is not", "return a fmi2Status")
            )
            what = f"{error.function} returns {status}"
        severity = Severity.WARNING if name == "calls" else Severity.ERROR
        if isinstance(error, MemoryError) or any(each in what for each in MACHINE):
            what, severity = f"not checked: this machine has too little left ({what or 'out of memory'})", Severity.NOTE
            remedy = "free some space, or raise the limits (ulimit -n, ulimit -v)"
        yield Finding(_with_messages(what, fmu), remedy, severity, check=name)
    finally:
        # changes to the process
        fmu.messages.clear()
        yield from named("process", closed_streams(standard))
        yield from named("process", disturbances(before, surroundings(fmu.folder)))
        now = printed_bytes()
        if now > printed:
            text = os.pread(1, min(now - printed, 200), printed).decode(errors="replace").strip().splitlines()
            message = "the FMU prints to standard output" + (f": {text[0]!r}" if text else "")
            remedy = "log through the callback: the importing tool's output is its own"
            yield Finding(message, remedy, Severity.WARNING, check="process")
        # files in the working directory, which are removed
        os.chdir(folder)
        for path in sorted(folder.iterdir()):
            message, remedy = (
                f"{path.name} is left in the working directory",
                "write where the importing tool says, or nowhere",
            )
            yield Finding(message, remedy, Severity.WARNING, path.name, check="process")
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def _with_messages(error: Exception | str, fmu: FmuUnderTest) -> str:
    """The error in one line, followed by the FMU's last two log messages."""
    logged = f" ({'; '.join(dict.fromkeys(fmu.messages[-2:]))})" if fmu.messages else ""
    return " ".join(f"{error}{logged}".split())


MACHINE = tuple(map(os.strerror, (errno.EMFILE, errno.ENFILE, errno.ENOSPC, errno.EDQUOT, errno.ENOMEM)))
"""What the system says where it has no file descriptors, space or memory left: no fault of the FMU."""

_STATUS = {
    2: ("fmi2Discard", "give the value, or return fmi2Error where it can't be had"),
    3: ("fmi2Error", "the call is legal here: carry it out, and log what goes wrong"),
    4: ("fmi2Fatal", "keep fmi2Fatal for what no instance in the process survives"),
    5: ("fmi2Pending", "return fmi2Pending from fmi2DoStep alone, and claim canRunAsynchronuously"),
}
"""fmi2Status → its name, and the remedy where the call should succeed."""


if __name__ == "__main__":
    main()
