"""The platforms of FMI 2.0 and what a compiler has to be told for each."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable
from dataclasses import dataclass

from flexfmu.fmu_build.errors import PlatformError


@dataclass(frozen=True)
class Platform:
    """A target of the build.

    Attributes:
        name: folder below ``binaries/``.
        suffix: file name ending of a shared library.
        zig_target: target triple for ``zig cc``; the Linux one asks for an old C library, so that the FMU runs anywhere.
        compile_flags: position independence, where the target knows it.
        link_flags: drop what nobody calls and all symbols that nobody needs.
    """

    name: str
    suffix: str
    zig_target: str
    compile_flags: tuple[str, ...]
    link_flags: tuple[str, ...]


PLATFORMS = {
    target.name: target
    for target in (
        Platform(
            "linux64",
            ".so",
            "x86_64-linux-gnu.2.17",
            ("-fPIC",),
            ("-shared", "-s", "-Wl,--gc-sections", "-Wl,-z,defs", "-lm"),
        ),
        Platform("win64", ".dll", "x86_64-windows-gnu", (), ("-shared", "-s", "-Wl,--gc-sections")),
        Platform("darwin64", ".dylib", "x86_64-macos", ("-fPIC",), ("-shared", "-Wl,-dead_strip", "-Wl,-x")),
    )
}
"""Every platform that can be built for, by its FMI 2.0 name."""

_SYSTEMS = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}
_MACHINES = {"x86_64", "amd64", "aarch64", "arm64"}


def native_platform() -> Platform:
    """The platform of this interpreter, named as FMI 2.0 importers on this machine look for it.

    Raises:
        PlatformError: FMI 2.0 has no name for this machine.
    """
    machine = platform.machine().lower()
    name = _SYSTEMS.get(sys.platform)
    if name is None or machine not in _MACHINES or sys.maxsize <= 2**32:
        known = ", ".join(PLATFORMS)
        raise PlatformError(f"no FMI 2.0 platform for {sys.platform} on {machine}; build on one of {known}")
    return PLATFORMS[name]


def find_platforms(names: Iterable[str] | None) -> tuple[Platform, ...]:
    """Platforms by name, sorted, without repetition; the native one when no name is given.

    Raises:
        PlatformError: a name is unknown.
    """
    wanted = sorted(set(names or ()))
    unknown = [name for name in wanted if name not in PLATFORMS]
    if unknown:
        raise PlatformError(f"unknown platform '{unknown[0]}'; choose from {', '.join(PLATFORMS)}")
    return tuple(PLATFORMS[name] for name in wanted) or (native_platform(),)
