"""The platforms of FMI 2.0 and what a compiler has to be told for each."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace

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
        zig_link_flags: what zig's linker needs besides, to leave out times and folders.
    """

    name: str
    suffix: str
    zig_target: str
    compile_flags: tuple[str, ...]
    link_flags: tuple[str, ...]
    zig_link_flags: tuple[str, ...] = ()


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
        Platform("win64", ".dll", "x86_64-windows-gnu", (), ("-shared", "-s", "-Wl,--gc-sections"), ("-Wl,-Brepro",)),
        Platform("darwin64", ".dylib", "x86_64-macos", ("-fPIC",), ("-shared", "-Wl,-dead_strip", "-Wl,-x"), ("-s",)),
    )
}
"""Every platform that can be built for, by its FMI 2.0 name."""

_SYSTEMS = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}
_MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


def native_platform() -> Platform:
    """The platform of this interpreter, named as FMI 2.0 importers on this machine look for it.

    FMI 2.0 knows no processors; on ARM its 64-bit names stand for ARM binaries.

    Raises:
        PlatformError: FMI 2.0 has no name for this machine.
    """
    name = _SYSTEMS.get(sys.platform)
    processor = _MACHINES.get(platform.machine().lower())
    if name is None or processor is None or sys.maxsize <= 2**32:
        where = f"{sys.platform} on {platform.machine()}"
        raise PlatformError(f"FMI 2.0 has no platform for {where}; build on one of {', '.join(PLATFORMS)}")
    target = PLATFORMS[name]
    return replace(target, zig_target=target.zig_target.replace("x86_64", processor))


def find_platforms(names: Iterable[str] | None) -> tuple[Platform, ...]:
    """Platforms by name, sorted, without repetition; the native one when no name is given.

    Raises:
        PlatformError: a name is unknown.
    """
    native = native_platform()
    wanted = sorted(set(names or ())) or [native.name]
    unknown = [name for name in wanted if name not in PLATFORMS]
    if unknown:
        raise PlatformError(f"unknown platform '{unknown[0]}'; choose from {', '.join(PLATFORMS)}")
    return tuple(native if name == native.name else PLATFORMS[name] for name in wanted)
