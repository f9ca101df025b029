"""Checks of the shared libraries: presence, name, exported functions, dependencies."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

import fmpy
from elftools.elf.dynamic import DynamicSection
from elftools.elf.elffile import ELFFile
from elftools.elf.gnuversions import GNUVerNeedSection
from elftools.elf.sections import SymbolTableSection

from flexfmu.fmu_build.toolchain import fmi_header_folder
from flexfmu.fmu_build.validation.description import interfaces
from flexfmu.fmu_build.validation.finding import Finding, Severity


def _functions(version: int, split: str) -> tuple[frozenset[str], frozenset[str]]:
    """All functions that an FMU for co-simulation, and one for model exchange, exports: by sections of the standard's header."""
    text = (fmi_header_folder() / f"fmi{version}Functions.h").read_text(encoding="utf-8")
    parts = re.split(split, text[text.index(f"fmi{version}FullName(") :])
    found = [frozenset(re.findall(rf"FullName\((fmi{version}\w+)\)", part)) for part in parts]
    common, exchange, cosimulation, *_ = found
    return common | cosimulation, common | exchange


FUNCTIONS = {2: _functions(2, "Functions for FMI2 for"), 3: _functions(3, "Functions for (?=Model|Co-|Sched)")}
"""Version of the standard → functions for co-simulation, and for model exchange (FMI 2.0.4, section 2.1)."""


def platform(description: Any) -> str:
    """Folder of this machine's binaries."""
    return str(fmpy.platform_tuple if description.fmiMajorVersion == 3 else fmpy.platform)


SUFFIXES = {
    **dict.fromkeys(("linux64", "linux32", "x86_64-linux", "aarch64-linux"), ".so"),
    **dict.fromkeys(("win64", "win32", "x86_64-windows", "aarch64-windows"), ".dll"),
    **dict.fromkeys(("darwin64", "darwin32", "x86_64-darwin", "aarch64-darwin"), ".dylib"),
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


def read_elf(library: bytes) -> tuple[set[str], list[str], list[str], tuple[int, int]]:
    """Read exports and dependencies of a 64-bit shared library in ELF; a damaged file raises any type of exception.

    Returns:
        Names of the exported symbols; names of the required libraries (DT_NEEDED); folders that are searched for them (RPATH,
        RUNPATH); the required version of glibc, (0, 0) if it needs none.
    """
    elf = ELFFile(io.BytesIO(library))
    # a damaged section count would make pyelftools run for ever
    if elf["e_shoff"] and elf.num_sections() * _SECTION_HEADER > len(library):
        raise ValueError("more sections than the file has room for")
    exports, needed, search_path, glibc = set[str](), [], [], (0, 0)
    for section in elf.iter_sections():
        if isinstance(section, SymbolTableSection) and section["sh_type"] == "SHT_DYNSYM":
            for symbol in section.iter_symbols():
                is_visible = symbol["st_other"]["visibility"] not in ("STV_INTERNAL", "STV_HIDDEN")
                if is_visible and symbol["st_shndx"] != "SHN_UNDEF" and symbol["st_info"]["bind"] != "STB_LOCAL":
                    exports.add(symbol.name)
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
    return exports, needed, search_path, glibc


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
    if platform(description) not in folders:
        has = ", ".join(folders) or "no platform at all"
        yield Finding(
            f"{library_name(description)} is missing, the FMU has {has}",
            "build it for this machine; what needs running was not checked",
            Severity.WARNING if folders else Severity.ERROR,
        )


def library_name(description: Any) -> str:
    """Path inside the FMU of the first interface's library for this machine."""
    folder = platform(description)
    return f"binaries/{folder}/{interfaces(description)[0].modelIdentifier}{SUFFIXES.get(folder, '')}"


def _check_folder(folder: str, description: Any, files: Mapping[str, bytes]) -> Iterator[Finding]:
    if folder not in SUFFIXES:
        known = ", ".join(name for name in SUFFIXES if ("-" in name) == (description.fmiMajorVersion == 3))
        yield Finding(f"no tool looks into binaries/{folder}/", f"use {known}", Severity.WARNING)
        return
    # a library for each model identifier, with the functions of its interfaces
    required: dict[str, frozenset[str]] = {}
    for element in interfaces(description):
        functions = FUNCTIONS[description.fmiMajorVersion][element is not description.coSimulation]
        required[element.modelIdentifier] = required.get(element.modelIdentifier, frozenset()) | functions
    named = [f"binaries/{folder}/{identifier}{SUFFIXES[folder]}" for identifier in required]
    for identifier, functions in required.items():
        name = f"binaries/{folder}/{identifier}{SUFFIXES[folder]}"
        if name not in files:
            there = sorted(file for file in files if file.startswith(f"binaries/{folder}/"))
            # Windows ignores case
            same = folder.startswith("win") and name.lower() in map(str.lower, there)
            severity = Severity.WARNING if same else Severity.ERROR
            message = f"{name} is missing, {folder}/ has {', '.join(there)}"
            others = [file for file in there if file.endswith(SUFFIXES[folder]) and file not in named]
            if len(others) == 1:
                message = f"{others[0]} is not named after the modelIdentifier {identifier}"
            yield Finding(message, f"name it {identifier}{SUFFIXES[folder]}", severity)
        elif folder.endswith(("linux64", "-linux")):
            yield from _check_elf(name, files, functions)
        elif not files[name].startswith(_MAGIC[SUFFIXES[folder]]):
            yield Finding(f"{name} is no library for {folder}", "compile it for this platform")


def _check_elf(name: str, files: Mapping[str, bytes], functions: frozenset[str]) -> Iterator[Finding]:
    if not files[name].startswith(_ELF64):
        yield Finding(f"{name}: not a 64-bit ELF file", "compile it for this platform")
        return
    try:
        exports, needed, search_path, glibc = read_elf(files[name])
    except Exception:  # pyelftools does not validate
        yield Finding(f"{name}: damaged ELF file", "compile it for this platform")
        return
    # processor
    machine = int.from_bytes(files[name][18:20], "little")
    if machine != _MACHINES.get(PurePosixPath(name).parts[1], machine):
        yield Finding(f"{name} is for another processor (ELF machine {machine})", "compile it for this platform")
    # exports: all FMI functions of the interface, nothing else
    if missing := sorted(functions - exports):
        yield Finding(f"{name} does not export {_few(missing)}", "implement and export them all")
    if foreign := sorted(symbol for symbol in exports if not symbol.startswith(("fmi2", "fmi3"))):
        yield Finding(
            f"{name} exports {_few(foreign)} besides the FMI functions",
            "hide them (-fvisibility=hidden): they collide with those of other FMUs",
            Severity.WARNING,
        )
    # dependencies
    beside = {PurePosixPath(file).name for file in files if PurePosixPath(file).parent == PurePosixPath(name).parent}
    found = {}  # problem → remedy
    if others := sorted(library for library in needed if not SYSTEM_LIBRARIES.fullmatch(library)):
        bundled = " (some lie beside it)" if beside & set(others) else ""
        needs = f"needs {_few(others)} at run time{bundled}"
        found[needs] = "link statically, or it will not load where they are missing"
    if outside := [path for path in search_path if not path.startswith("$ORIGIN")]:
        found[f"looks for libraries in {_few(outside)}"] = "use $ORIGIN"
    # an older glibc can't load the binary
    if glibc > OLD_GLIBC:
        version, old = (".".join(map(str, number)) for number in (glibc, OLD_GLIBC))
        found[f"needs glibc {version}"] = f"build against glibc {old} or older to run on older machines"
    for problem, remedy in found.items():
        yield Finding(f"{name} {problem}", remedy, Severity.WARNING, check="dependencies")


def _few(names: list[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
