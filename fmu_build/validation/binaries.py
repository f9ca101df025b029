"""The shared libraries: there, well named, exporting the interface and nothing else, needing nothing unusual."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

import fmpy

from flexfmu.fmu_build.validation.description import interfaces
from flexfmu.fmu_build.validation.elf import ElfFacts, NotElfError, read_elf
from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.functions import COSIMULATION_FUNCTIONS, EXCHANGE_FUNCTIONS

SUFFIXES = {
    "linux64": ".so",
    "linux32": ".so",
    "win64": ".dll",
    "win32": ".dll",
    "darwin64": ".dylib",
    "darwin32": ".dylib",
    "x86_64-linux": ".so",
    "aarch64-linux": ".so",
    "x86_64-windows": ".dll",
    "aarch64-windows": ".dll",
    "x86_64-darwin": ".dylib",
    "aarch64-darwin": ".dylib",
}
"""Platform folder of FMI 2.0 or 3.0 → ending of its library's name."""

_MAGIC = {
    ".so": (b"\x7fELF",),
    ".dll": (b"MZ",),
    ".dylib": (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe", b"\xca\xfe\xba\xbe"),
}
"""What libraries begin with."""

_MACHINES = {"linux64": 62, "x86_64-linux": 62, "aarch64-linux": 183}
"""e_machine of ELF files by folder."""

SYSTEM_LIBRARIES = re.compile(r"(lib(c|m|dl|pthread|rt|gcc_s)\.so\.\d+|ld-linux.*)")
"""What every Linux with glibc has, a minimal container too."""

OLD_GLIBC = (2, 28)
"""The oldest glibc in general use: enterprise distributions of 2019, and Python's manylinux_2_28."""


def check_binaries(description: Any, files: Mapping[str, bytes]) -> Iterator[Finding]:
    """Findings about all libraries of the FMU.

    Args:
        description: model description as fmpy reads it.
        files: content of the FMU, path inside → bytes.
    """
    folders = sorted({PurePosixPath(name).parts[1] for name in files if name.count("/") > 1 and _is_binary(name)})
    for folder in folders:
        yield from _check_folder(folder, description, files)
    if fmpy.platform not in folders:
        has = ", ".join(folders) or "no platform at all"
        yield Finding(
            "binary",
            f"{library_name(description, fmpy.platform)} is missing, the FMU has {has}",
            "build it for this machine; what needs running was not checked",
            Severity.WARNING if folders else Severity.ERROR,
        )


def library_name(description: Any, platform: str) -> str:
    """Path of the library inside the FMU, of the first interface."""
    return f"binaries/{platform}/{interfaces(description)[0].modelIdentifier}{SUFFIXES.get(platform, '')}"


def _is_binary(name: str) -> bool:
    return name.startswith("binaries/")


def _check_folder(folder: str, description: Any, files: Mapping[str, bytes]) -> Iterator[Finding]:
    if folder not in SUFFIXES:
        known = ", ".join(list(SUFFIXES)[:6])
        yield Finding("binary", f"no tool looks into binaries/{folder}/", f"use {known}", Severity.WARNING)
        return
    required = _required_functions(description)
    for identifier, functions in required.items():
        name = f"binaries/{folder}/{identifier}{SUFFIXES[folder]}"
        if name not in files:
            there = sorted(file for file in files if file.startswith(f"binaries/{folder}/"))
            # Windows doesn't mind upper and lower case
            same = folder.startswith("win") and name.lower() in map(str.lower, there)
            yield Finding(
                "binary",
                f"{name} is missing, {folder}/ has {', '.join(there)}",
                "name it like the modelIdentifier",
                Severity.WARNING if same else Severity.ERROR,
            )
        elif folder.endswith(("linux64", "-linux")):
            yield from _check_elf(name, files, functions)
        elif not files[name].startswith(_MAGIC[SUFFIXES[folder]]):
            yield Finding("binary", f"{name} is no library for {folder}", "compile it for this platform")


def _required_functions(description: Any) -> dict[str, frozenset[str]]:
    """Model identifier → functions that its library has to export."""
    required: dict[str, frozenset[str]] = {}
    for element, functions in (
        (description.coSimulation, COSIMULATION_FUNCTIONS),
        (description.modelExchange, EXCHANGE_FUNCTIONS),
    ):
        if element is not None:
            required[element.modelIdentifier] = required.get(element.modelIdentifier, frozenset()) | functions
    return required


def _check_elf(name: str, files: Mapping[str, bytes], functions: frozenset[str]) -> Iterator[Finding]:
    try:
        facts = read_elf(files[name])
    except NotElfError as error:
        yield Finding("binary", f"{name}: {error}", "compile it for this platform")
        return
    machine = int.from_bytes(files[name][18:20], "little")
    if machine != _MACHINES.get(PurePosixPath(name).parts[1], machine):
        yield Finding(
            "binary", f"{name} is for another processor (ELF machine {machine})", "compile it for this platform"
        )
    if missing := sorted(functions - facts.exports):
        yield Finding("binary", f"{name} does not export {_few(missing)}", "implement and export them all")
    if foreign := sorted(symbol for symbol in facts.exports if not symbol.startswith("fmi2")):
        yield Finding(
            "binary",
            f"{name} exports {_few(foreign)} besides the FMI functions",
            "hide them (-fvisibility=hidden): they collide with those of other FMUs",
            Severity.WARNING,
        )
    yield from _check_dependencies(name, files, facts)


def _check_dependencies(name: str, files: Mapping[str, bytes], facts: ElfFacts) -> Iterator[Finding]:
    beside = {PurePosixPath(file).name for file in files if PurePosixPath(file).parent == PurePosixPath(name).parent}
    if others := sorted(library for library in facts.needed if not SYSTEM_LIBRARIES.fullmatch(library)):
        bundled = " (some lie beside it)" if beside & set(others) else ""
        yield Finding(
            "dependencies",
            f"{name} needs {_few(others)} at run time{bundled}",
            "link statically, or it will not load where they are missing",
            Severity.WARNING,
        )
    if outside := [path for path in facts.search_path if not path.startswith("$ORIGIN")]:
        yield Finding("dependencies", f"{name} looks for libraries in {_few(outside)}", "use $ORIGIN", Severity.WARNING)
    if facts.glibc > OLD_GLIBC:
        version, old = (".".join(map(str, number)) for number in (facts.glibc, OLD_GLIBC))
        yield Finding(
            "dependencies",
            f"{name} needs glibc {version}",
            f"build against glibc {old} or older to run on older machines",
            Severity.WARNING,
        )


def _few(names: list[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
