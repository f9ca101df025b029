"""Process state that an FMU must not change: locale, rounding, signal handlers, standard streams, files."""

from __future__ import annotations

import ctypes
import locale
import os
import platform
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.fmu_build.validation.finding import Finding, Severity

_ROUNDING = {0: "nearest", 0x400: "downwards", 0x800: "upwards", 0xC00: "towards zero"}
"""Return value of fegetround on x86 → name of the rounding mode."""


def surroundings(fmu: Path) -> dict[str, Any]:
    """The process state that an FMU must not change, name → value.

    Args:
        fmu: folder of the extracted FMU.
    """
    seen: dict[str, Any] = {
        "working directory": os.getcwd(),
        "locale for numbers": locale.setlocale(locale.LC_NUMERIC),
        "rounding of numbers": float(np.float64(1.0) / np.float64(3.0)) + float(np.float64(-1.0) / np.float64(3.0)),
        "treatment of denormal numbers": bool(np.float64(5e-324) * np.float64(1.0)),
        "resources": {
            str(path.relative_to(fmu)): path.stat().st_mtime_ns
            for path in (fmu / "resources").rglob("*")
            if path.is_file()
        },
    }
    # state of the C library: rounding mode, environment, umask
    if os.name == "posix":
        libc = ctypes.CDLL(None)
        seen["rounding of numbers"] = libc.fegetround() if hasattr(libc, "fegetround") else 0
        seen["environment"] = _environment(libc)
        seen["mask of new files"] = os.umask(0)
        os.umask(seen["mask of new files"])
    # on Linux: signal handlers and open files
    status = Path("/proc/self/status")
    if status.exists():
        lines = (
            line.split(":", 1) for line in status.read_text().splitlines() if line.startswith(("SigCgt", "SigIgn"))
        )
        seen["signal handlers"] = [value.strip() for _, value in lines]
        seen["open files"] = len(os.listdir("/proc/self/fd"))
    return seen


def _environment(libc: Any) -> dict[bytes, bytes]:
    """The environment variables of the C library."""
    pointer = ctypes.POINTER(ctypes.c_char_p).in_dll(libc, "environ")
    entries: list[bytes] = []
    while pointer and (entry := pointer[len(entries)]) is not None:
        entries.append(entry)
    return dict(entry.partition(b"=")[::2] for entry in entries)


def disturbances(before: dict[str, Any], after: dict[str, Any]) -> Iterator[Finding]:
    """Yield findings about changes of the process state; reported entries are removed from ``before``."""
    for what, old in list(before.items()):
        new = after[what]
        # report each change once
        if new != old:
            del before[what]
        if what == "open files" and new > old:
            yield _disturbance("leaves files open", "close them")
        elif what == "resources" and new != old:
            names = sorted(name for name in {*old, *new} if old.get(name) != new.get(name))
            message = f"the FMU writes into its resources: {', '.join(names[:3])}"
            remedy = "write elsewhere: they may be read-only, and other instances use them"
            yield Finding("process", message, remedy, Severity.WARNING)
        elif what == "environment" and new != old:
            names = sorted(name.decode(errors="replace") for name in {*old, *new} if old.get(name) != new.get(name))
            yield _disturbance(f"changes the environment: {', '.join(names)}", "leave it alone")
        elif what != "open files" and new != old:
            shown = {"mask of new files": f"{new:#05o}" if isinstance(new, int) else ""}
            if what == "rounding of numbers" and platform.machine() in ("x86_64", "AMD64"):
                shown[what] = _ROUNDING.get(new, str(new))
            change = "" if what == "signal handlers" else f" to {shown.get(what, new)}"
            yield _disturbance(f"changes the {what}{change}", "restore it before each FMI call returns")


def _disturbance(what: str, remedy: str) -> Finding:
    return Finding("process", f"the FMU {what}, which belongs to the importing tool", remedy, Severity.WARNING)


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
            yield Finding("process", message, "leave it open", Severity.WARNING)


def printed_bytes() -> int:
    """Size of the file behind standard output, after a flush [bytes]."""
    ctypes.CDLL(None).fflush(None)
    return os.fstat(1).st_size


def printed_text(before: int) -> Iterator[Finding]:
    """Yield a finding if standard output has grown beyond ``before`` bytes."""
    now = printed_bytes()
    if now > before:
        text = os.pread(1, min(now - before, 200), before).decode(errors="replace").strip().splitlines()
        message = "the FMU prints to standard output" + (f": {text[0]!r}" if text else "")
        yield Finding(
            "process", message, "log through the callback: the importing tool's output is its own", Severity.WARNING
        )


def files_left() -> Iterator[Finding]:
    """Yield a finding for each file that the FMU leaves in the working directory, and remove it."""
    for path in sorted(Path.cwd().iterdir()):
        yield Finding(
            "process",
            f"{path.name} is left in the working directory",
            "write where the importing tool says, or nowhere",
            Severity.WARNING,
            path.name,
        )
        shutil.rmtree(path) if path.is_dir() else path.unlink()
