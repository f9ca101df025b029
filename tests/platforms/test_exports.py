"""What the binaries of all platforms show and need, as an independent library reads their formats."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

from flexfmu.fmu_build.sources import Sources
from flexfmu.fmu_build.toolchain import PLATFORMS, find_compiler, fmi_header_folder, native_platform

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


def lief() -> Any:
    """The library."""
    return pytest.importorskip("lief")


def _fmi_functions(description: str) -> set[str]:
    """What the standard's header declares for the interfaces that the model description names."""
    header = (fmi_header_folder() / "fmi2Functions.h").read_text(encoding="utf-8")
    _, _, _, common, exchange, cosimulation = re.split(r"^(?:Common Functions|Functions for FMI2)", header, flags=re.M)[
        -6:
    ]
    interfaces = {"<ModelExchange": exchange, "<CoSimulation": cosimulation}
    sections = [common, *(section for tag, section in interfaces.items() if tag in description)]
    return {name for section in sections for name in re.findall(r"FMI2_Export \w+ +(fmi2\w+);", section)}


def _exports(name: str, library: bytes) -> set[str]:
    binary = lief().parse(list(library))
    if PLATFORMS[name].suffix == ".dylib":
        names = {symbol.name for symbol in binary.symbols if symbol.has_export_info}
        return {each.removeprefix("_") for each in names - OF_ZIG_S_LINKER}
    if name.startswith("win"):
        return {entry.name for entry in binary.get_export().entries}
    return {symbol.name for symbol in binary.exported_symbols}


def _needs(name: str, library: bytes) -> list[str]:
    binary = lief().parse(list(library))
    if PLATFORMS[name].suffix != ".dylib":
        return list(binary.libraries)
    dependencies = [each for each in binary.libraries if each.command != lief().MachO.LoadCommand.TYPE.ID_DYLIB]
    return [each.name for each in dependencies]


def _glibc_versions(library: bytes) -> set[tuple[int, ...]]:
    requirements = lief().parse(list(library)).symbols_version_requirement
    names = [version.name for requirement in requirements for version in requirement.get_auxiliary_symbols()]
    return {tuple(map(int, name.removeprefix("GLIBC_").split("."))) for name in names}


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
@pytest.mark.parametrize("name", PLATFORMS)
def test_exports_are_the_fmi_functions_and_nothing_else(
    name: str, library_for: LibraryFor, robot_sources: Sources
) -> None:
    """An importer finds every function of the interfaces, and two FMUs in one process cannot see each other's."""
    assert _exports(name, library_for(name)) == _fmi_functions(robot_sources.description)


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
@pytest.mark.parametrize("name", PLATFORMS)
def test_nothing_is_needed_but_the_c_library(name: str, library_for: LibraryFor) -> None:
    """An FMU is carried to machines of which nothing is known."""
    needed = _needs(name, library_for(name))
    assert needed
    assert [each for each in needed if not re.fullmatch(NEEDED[PLATFORMS[name].suffix], each, re.IGNORECASE)] == []


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
@pytest.mark.parametrize("name", OLDEST_GLIBC)
def test_old_linux_systems_can_load_it(name: str, library_for: LibraryFor) -> None:
    """Built on a new system, an FMU must still run on an enterprise one of ten years ago."""
    assert max(_glibc_versions(library_for(name))) <= OLDEST_GLIBC[name]


@pytest.mark.slow
def test_the_native_compiler_keeps_to_old_versions_too(library_for: LibraryFor) -> None:
    """Not only zig, which is told so, but whatever compiler this machine has."""
    native = native_platform()
    if native.zig_target != PLATFORMS["linux64"].zig_target:
        pytest.skip(f"{find_compiler(native).command[0]} builds for {native.zig_target} here")
    assert max(_glibc_versions(library_for("linux64"))) <= OLDEST_GLIBC["linux64"]
