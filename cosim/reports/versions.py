"""What a result was computed with: versions of the packages, the platform, and the compiler of the FMU."""

from __future__ import annotations

import platform
import re
import zipfile
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("flexfmu", "casadi", "fmpy", "numpy")

_COMPILER = re.compile(rb"GCC: \([^)\0]*\) [\w.+-]+|(?:\w+ )?clang version [\w.+-]+|Apple clang version [\w.+-]+")
"""How compilers sign what they make (section ``.comment`` of an ELF library)."""


def versions(fmu: Path | None = None) -> Mapping[str, str | None]:
    """Versions by name; None where one can't be found out.

    Args:
        fmu: the FMU whose compiler is named under ``compiler``.
    """
    return {
        **{name: _package(name) for name in PACKAGES},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "compiler": None if fmu is None else compiler_of(fmu),
    }


def compiler_of(fmu: Path) -> str | None:
    """The compiler that made the FMU's library for this machine, by its own signature in the file; None if unsigned."""
    try:
        with zipfile.ZipFile(fmu) as archive:
            libraries = [name for name in archive.namelist() if name.startswith("binaries/") and not name.endswith("/")]
            signatures = [match for name in libraries for match in _COMPILER.findall(archive.read(name))]
    except (OSError, zipfile.BadZipFile):
        return None
    return ", ".join(sorted({signature.decode("ascii", "replace") for signature in signatures})) or None


def _package(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
