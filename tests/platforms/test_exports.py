"""What the binaries of all platforms show and need, as an independent library reads their formats."""

from __future__ import annotations

import re
from collections.abc import Callable
from time import sleep
from typing import Any

import pytest

from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.sources import Sources
from flexfmu.fmu_build.toolchain import PLATFORMS, find_compiler, native_platform
from flexfmu.fmu_build.validation.binaries import FUNCTIONS
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.symbolic import SymbolicModel

pytestmark = pytest.mark.slow

LibraryFor = Callable[..., bytes]

OF_ZIG_S_LINKER = {"__mh_dylib_header", "___dso_handle"}
"""What zig's linker exports from every library for macOS, whatever it is told; both are addresses of the library itself."""

NEEDED = {
    ".so": r"lib[cm]\.so\.6",
    ".dll": r"(api-ms-win-crt-(heap|math|private|runtime|stdio|string|utility)-l1-1-0|kernel32)\.dll",
    ".dylib": r"/usr/lib/libSystem\.B\.dylib",
}
"""The C library of each kind of system, which every machine with it has."""

OLDEST_GLIBC = {"linux64": (2, 14), "aarch64-linux": (2, 17)}
"""Of 2011, and the first one that ARM had."""


@pytest.mark.usefixtures("zig")
@pytest.mark.parametrize("name", PLATFORMS)
def test_exports_and_needs(name: str, library_for: LibraryFor) -> None:
    """An importer finds every function of the interfaces, and two FMUs in one process cannot see each other's. An FMU is carried
    to machines of which nothing is known but their C library, which may be that of an enterprise system of ten years ago."""
    lief = pytest.importorskip("lief")
    binary, suffix = lief.parse(list(library_for(name))), PLATFORMS[name].suffix
    if suffix == ".dylib":
        names = {symbol.name for symbol in binary.symbols if symbol.has_export_info}
        exports = {each.removeprefix("_") for each in names - OF_ZIG_S_LINKER}
        own = lief.MachO.LoadCommand.TYPE.ID_DYLIB
        needed = [each.name for each in binary.libraries if each.command != own]
    else:
        needed = list(binary.libraries)
        exported = binary.get_export().entries if suffix == ".dll" else binary.exported_symbols
        exports = {each.name for each in exported}
    assert exports == frozenset.union(*FUNCTIONS[2])
    assert needed
    assert [each for each in needed if not re.fullmatch(NEEDED[suffix], each, re.IGNORECASE)] == []
    if name in OLDEST_GLIBC:
        assert _glibc_version(binary) <= OLDEST_GLIBC[name]


def _glibc_version(binary: Any) -> tuple[int, ...]:
    """The newest one that is needed."""
    names = [each.name for needed in binary.symbols_version_requirement for each in needed.get_auxiliary_symbols()]
    return max(tuple(map(int, name.removeprefix("GLIBC_").split("."))) for name in names)


def test_the_native_compiler_keeps_to_old_versions_too(library_for: LibraryFor) -> None:
    """Not only zig, which is told so, but whatever compiler this machine has."""
    lief, native = pytest.importorskip("lief"), native_platform()
    if native.zig_target != PLATFORMS["linux64"].zig_target:
        pytest.skip(f"{find_compiler(native).command[0]} builds for {native.zig_target} here")
    assert _glibc_version(lief.parse(list(library_for("linux64")))) <= OLDEST_GLIBC["linux64"]


@pytest.mark.usefixtures("zig")
@pytest.mark.parametrize("name", PLATFORMS)
def test_binaries_hold_no_time(name: str, robot_sources: Sources, library_for: LibraryFor) -> None:
    """Linked again a second later, the library has the same bytes, on every platform."""
    first = library_for(name)
    sleep(1.1)
    assert compile_library(robot_sources, find_compiler(PLATFORMS[name])) == first


@pytest.mark.usefixtures("zig")
def test_zig_builds_sound_fmus_too(robot: SymbolicModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a machine without a compiler the one from PyPI gives the same good FMU."""
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert validate_fmu(build_fmu(robot, stop_time=0.1).path) == []
