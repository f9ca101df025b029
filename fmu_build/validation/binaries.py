"""Checks of the shared libraries: presence, name, exported functions, dependencies."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import fmpy
from elftools.elf.dynamic import DynamicSection
from elftools.elf.elffile import ELFFile
from elftools.elf.gnuversions import GNUVerNeedSection
from elftools.elf.sections import SymbolTableSection

from flexfmu.fmu_build.validation.description import interfaces
from flexfmu.fmu_build.validation.finding import Finding, Severity

_FUNCTIONS = (
    "GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment EnterInitializationMode "
    "ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString "
    "GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate "
    "GetDirectionalDerivative"
)
_COSIMULATION = (
    "SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus GetIntegerStatus "
    "GetBooleanStatus GetStringStatus"
)
_EXCHANGE = (
    "EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime SetContinuousStates "
    "GetDerivatives GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates"
)


def _names(text: str) -> frozenset[str]:
    return frozenset(f"fmi2{name}" for name in text.split())


COSIMULATION_FUNCTIONS = _names(f"{_FUNCTIONS} {_COSIMULATION}")
"""All functions that an FMU for co-simulation exports (FMI 2.0.4, section 2.1 and fmi2Functions.h)."""

EXCHANGE_FUNCTIONS = _names(f"{_FUNCTIONS} {_EXCHANGE}")
"""All functions that an FMU for model exchange exports (FMI 2.0.4, section 2.1 and fmi2Functions.h)."""

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
"""Platform folder of FMI 2.0 or 3.0 → file suffix of its libraries."""

_MAGIC = {
    ".so": (b"\x7fELF",),
    ".dll": (b"MZ",),
    ".dylib": (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe", b"\xca\xfe\xba\xbe"),
}
"""File suffix → possible first bytes of the library."""

_MACHINES = {"linux64": 62, "x86_64-linux": 62, "aarch64-linux": 183}
"""Platform folder → e_machine of its ELF files."""

SYSTEM_LIBRARIES = re.compile(r"(lib(c|m|dl|pthread|rt|gcc_s)\.so\.\d+|ld-linux.*)")
"""Libraries on every Linux with glibc, including minimal containers."""

OLD_GLIBC = (2, 28)
"""The oldest glibc in general use: enterprise distributions of 2019, and Python's manylinux_2_28."""


_ELF64 = b"\x7fELF\x02\x01"
"""First bytes of a 64-bit little-endian ELF file."""

_SECTION_HEADER = 64
"""Size of a section header in a 64-bit ELF file [bytes]."""

_TEXTS = {"DT_NEEDED": "needed", "DT_RPATH": "rpath", "DT_RUNPATH": "runpath"}
"""Tag of the dynamic section → attribute of pyelftools with its text."""


class NotElfError(ValueError):
    """Not a 64-bit little-endian ELF file, or a damaged one."""


@dataclass(frozen=True)
class ElfFacts:
    """Exports and dependencies of an ELF shared library.

    Attributes:
        exports: names of the exported symbols.
        needed: names of the required libraries (DT_NEEDED).
        search_path: folders that are searched for them (RPATH, RUNPATH).
        glibc: required version of glibc; (0, 0) if it needs none.
    """

    exports: frozenset[str]
    needed: tuple[str, ...]
    search_path: tuple[str, ...]
    glibc: tuple[int, int]


def read_elf(library: bytes) -> ElfFacts:
    """Read exports and dependencies of a shared library.

    Raises:
        NotElfError: not a 64-bit little-endian ELF file, or damaged.
    """
    if not library.startswith(_ELF64):
        raise NotElfError("not a 64-bit ELF file")
    try:
        return _elf_facts(library)
    except Exception as error:  # pyelftools does not validate: a damaged file raises any type
        raise NotElfError("damaged ELF file") from error


def _elf_facts(library: bytes) -> ElfFacts:
    """Read exports and dependencies; a damaged file raises exceptions of pyelftools."""
    elf = ELFFile(io.BytesIO(library))
    # a damaged section count would make pyelftools run for ever
    if elf["e_shoff"] and elf.num_sections() * _SECTION_HEADER > len(library):
        raise ValueError("more sections than the file has room for")
    exports: set[str] = set()
    needed, search_path, glibc = [], [], (0, 0)
    for section in elf.iter_sections():
        if isinstance(section, SymbolTableSection) and section["sh_type"] == "SHT_DYNSYM":
            exports |= {symbol.name for symbol in section.iter_symbols() if _is_exported(symbol)}
        elif isinstance(section, DynamicSection):
            for tag in section.iter_tags():
                text = getattr(tag, _TEXTS.get(tag.entry.d_tag, ""), "")
                if tag.entry.d_tag == "DT_NEEDED":
                    needed.append(text)
                else:
                    search_path += [folder for folder in text.split(":") if folder]
        elif isinstance(section, GNUVerNeedSection):
            # read the table of names: the linked lists of versions may be endless in a damaged file
            names = section.stringtable
            text = library[names["sh_offset"] : names["sh_offset"] + names["sh_size"]]
            for major, minor in re.findall(rb"\0GLIBC_(\d+)\.(\d+)", text):
                glibc = max(glibc, (int(major), int(minor)))
    return ElfFacts(frozenset(exports), tuple(needed), tuple(search_path), glibc)


def _is_exported(symbol: Any) -> bool:
    """Whether a library defines and exports a symbol."""
    visible = symbol["st_other"]["visibility"] not in ("STV_INTERNAL", "STV_HIDDEN")
    return visible and symbol["st_shndx"] != "SHN_UNDEF" and symbol["st_info"]["bind"] != "STB_LOCAL"


def check_binaries(description: Any, files: Mapping[str, bytes]) -> Iterator[Finding]:
    """Yield findings about all shared libraries of the FMU.

    Args:
        description: model description as read by fmpy.
        files: path inside the FMU → content.
    """
    # a folder for each platform
    folders = sorted(
        {PurePosixPath(name).parts[1] for name in files if name.count("/") > 1 and name.startswith("binaries/")}
    )
    for folder in folders:
        yield from _check_folder(folder, description, files)
    # a folder for this machine
    if fmpy.platform not in folders:
        has = ", ".join(folders) or "no platform at all"
        yield Finding(
            "binary",
            f"{library_name(description, fmpy.platform)} is missing, the FMU has {has}",
            "build it for this machine; what needs running was not checked",
            Severity.WARNING if folders else Severity.ERROR,
        )


def library_name(description: Any, platform: str) -> str:
    """Path inside the FMU of the first interface's library."""
    return f"binaries/{platform}/{interfaces(description)[0].modelIdentifier}{SUFFIXES.get(platform, '')}"


def _check_folder(folder: str, description: Any, files: Mapping[str, bytes]) -> Iterator[Finding]:
    if folder not in SUFFIXES:
        known = ", ".join(list(SUFFIXES)[:6])
        yield Finding("binary", f"no tool looks into binaries/{folder}/", f"use {known}", Severity.WARNING)
        return
    # a library for each model identifier, with the functions of its interfaces
    required: dict[str, frozenset[str]] = {}
    for element, functions in (
        (description.coSimulation, COSIMULATION_FUNCTIONS),
        (description.modelExchange, EXCHANGE_FUNCTIONS),
    ):
        if element is not None:
            required[element.modelIdentifier] = required.get(element.modelIdentifier, frozenset()) | functions
    for identifier, functions in required.items():
        name = f"binaries/{folder}/{identifier}{SUFFIXES[folder]}"
        if name not in files:
            there = sorted(file for file in files if file.startswith(f"binaries/{folder}/"))
            # Windows ignores case
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


def _check_elf(name: str, files: Mapping[str, bytes], functions: frozenset[str]) -> Iterator[Finding]:
    try:
        facts = read_elf(files[name])
    except NotElfError as error:
        yield Finding("binary", f"{name}: {error}", "compile it for this platform")
        return
    # processor
    machine = int.from_bytes(files[name][18:20], "little")
    if machine != _MACHINES.get(PurePosixPath(name).parts[1], machine):
        yield Finding(
            "binary", f"{name} is for another processor (ELF machine {machine})", "compile it for this platform"
        )
    # exports: all FMI functions of the interface, nothing else
    if missing := sorted(functions - facts.exports):
        yield Finding("binary", f"{name} does not export {_few(missing)}", "implement and export them all")
    if foreign := sorted(symbol for symbol in facts.exports if not symbol.startswith("fmi2")):
        yield Finding(
            "binary",
            f"{name} exports {_few(foreign)} besides the FMI functions",
            "hide them (-fvisibility=hidden): they collide with those of other FMUs",
            Severity.WARNING,
        )
    # dependencies
    beside = {PurePosixPath(file).name for file in files if PurePosixPath(file).parent == PurePosixPath(name).parent}
    found = {}
    # libraries that other machines may lack, or have elsewhere
    if others := sorted(library for library in facts.needed if not SYSTEM_LIBRARIES.fullmatch(library)):
        bundled = " (some lie beside it)" if beside & set(others) else ""
        needs = f"needs {_few(others)} at run time{bundled}"
        found[needs] = "link statically, or it will not load where they are missing"
    if outside := [path for path in facts.search_path if not path.startswith("$ORIGIN")]:
        found[f"looks for libraries in {_few(outside)}"] = "use $ORIGIN"
    # an older glibc can't load the binary
    if facts.glibc > OLD_GLIBC:
        version, old = (".".join(map(str, number)) for number in (facts.glibc, OLD_GLIBC))
        found[f"needs glibc {version}"] = f"build against glibc {old} or older to run on older machines"
    for problem, remedy in found.items():
        yield Finding("dependencies", f"{name} {problem}", remedy, Severity.WARNING)


def _few(names: list[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
