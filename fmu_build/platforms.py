"""The platforms of FMI 2.0 and their compiler options."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace

from flexfmu.fmu_build.errors import PlatformError


@dataclass(frozen=True)
class Platform:
    """A target platform.

    Attributes:
        name: folder below ``binaries/``.
        suffix: file suffix of shared libraries.
        zig_target: target triple for ``zig cc``; on Linux with an old glibc, so that the FMU runs on old systems.
        compile_flags: flags for position-independent code.
        link_flags: flags that remove unused functions and symbols.
        zig_link_flags: further flags for zig's linker, for reproducible output.
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
"""Supported platforms by name: FMI 2.0 names for x86, FMI 3.0 platform tuples for ARM (allowed since FMI 2.0.4).

On ARM, older importers and those that ignore the processor (fmpy) use the x86 name.
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
    """The platform of this interpreter, with the name that FMI 2.0 importers on this machine use.

    Most importers (fmpy among them) ignore the processor, so on ARM the x86 names denote ARM binaries.

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
    """Platforms by name, sorted and unique; the native platform if there are no names.

    Names have the meaning of the standard on every machine: ``linux64`` is x86.

    Raises:
        PlatformError: a name is unknown.
    """
    wanted = sorted(set(names or ()))
    unknown = [name for name in wanted if name not in PLATFORMS]
    if unknown:
        raise PlatformError(f"unknown platform '{unknown[0]}'; choose from {', '.join(PLATFORMS)}")
    return tuple(PLATFORMS[name] for name in wanted) or (native_platform(),)
