"""The platforms of FMI 2.0 and the options that a compiler needs for each."""

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
        link_flags: drop functions without callers and all unneeded symbols.
        zig_link_flags: what zig's linker needs besides, to leave out times and folders.
    """

    name: str
    suffix: str
    zig_target: str
    compile_flags: tuple[str, ...]
    link_flags: tuple[str, ...]
    zig_link_flags: tuple[str, ...] = ()


def _linux(name: str, processor: str) -> Platform:
    link_flags = ("-shared", "-s", "-Wl,--gc-sections", "-Wl,-z,defs")
    return Platform(name, ".so", f"{processor}-linux-gnu.2.17", ("-fPIC",), link_flags)


def _darwin(name: str, zig_target: str) -> Platform:
    link_flags = ("-shared", "-Wl,-dead_strip", "-Wl,-x")
    return Platform(name, ".dylib", zig_target, ("-fPIC",), link_flags, ("-s",))


PLATFORMS = {
    target.name: target
    for target in (
        _linux("linux64", "x86_64"),
        Platform("win64", ".dll", "x86_64-windows-gnu", (), ("-shared", "-s", "-Wl,--gc-sections"), ("-Wl,-Brepro",)),
        _darwin("darwin64", "x86_64-macos.10.13"),
        _linux("aarch64-linux", "aarch64"),
        _darwin("aarch64-darwin", "aarch64-macos.11.0"),
    )
}
"""Every platform that can be built for, by its name in FMI 2.0.4 and later: x86 as ever, ARM by FMI 3.0's platform tuple.

Importers on ARM that are older, or that ignore the processor (fmpy), look into the folder of the x86 name instead.
"""

_SYSTEMS = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}
_ZIG_TARGETS = {
    ("linux64", "x86_64"): PLATFORMS["linux64"].zig_target,
    ("win64", "x86_64"): PLATFORMS["win64"].zig_target,
    ("darwin64", "x86_64"): PLATFORMS["darwin64"].zig_target,
    ("linux64", "aarch64"): PLATFORMS["aarch64-linux"].zig_target,
    ("win64", "aarch64"): "aarch64-windows-gnu",
    ("darwin64", "aarch64"): PLATFORMS["aarch64-darwin"].zig_target,
}
_MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


def native_platform() -> Platform:
    """The platform of this interpreter, named as FMI 2.0 importers on this machine look for it.

    Most of them don't ask for the processor (fmpy among them): on ARM the 64-bit names stand for ARM binaries there.

    Raises:
        PlatformError: FMI 2.0 has no name for this machine.
    """
    name = _SYSTEMS.get(sys.platform)
    processor = _MACHINES.get(platform.machine().lower())
    if name is None or processor is None or sys.maxsize <= 2**32:
        where = f"{sys.platform} on {platform.machine()}"
        raise PlatformError(f"FMI 2.0 has no platform for {where}; build on one of {', '.join(PLATFORMS)}")
    return replace(PLATFORMS[name], zig_target=_ZIG_TARGETS[name, processor])


def find_platforms(names: Iterable[str] | None) -> tuple[Platform, ...]:
    """Platforms by name, sorted, without repetition; the native one when no name is given.

    A name means what the standard says, on every machine: ``linux64`` is for x86.

    Raises:
        PlatformError: a name is unknown.
    """
    wanted = sorted(set(names or ()))
    unknown = [name for name in wanted if name not in PLATFORMS]
    if unknown:
        raise PlatformError(f"unknown platform '{unknown[0]}'; choose from {', '.join(PLATFORMS)}")
    return tuple(PLATFORMS[name] for name in wanted) or (native_platform(),)
