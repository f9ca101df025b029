"""The versions and platforms of FMI, and the C compiler for each: finds one, compiles in parallel, links a shared library."""

from __future__ import annotations

import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from flexfmu.fmu_build.errors import CompileError, MissingCompilerError, PlatformError

FmiVersion = Literal["2", "3"]
"""Version of the FMI standard of an FMU: 2.0 or 3.0."""


@dataclass(frozen=True)
class Platform:
    """A target platform.

    Attributes:
        name: folder below ``binaries/`` in FMI 2.0.
        suffix: file suffix of shared libraries.
        zig_target: target triple for ``zig cc``; on Linux with an old glibc, so that the FMU runs on old systems.
        compile_flags: flags for position-independent code.
        link_flags: flags that remove unused functions and symbols.
        zig_link_flags: further flags for zig's linker, for reproducible output.
        host: folder of the C runtime with what only this platform needs; empty if there is none.
    """

    name: str
    suffix: str
    zig_target: str
    compile_flags: tuple[str, ...]
    link_flags: tuple[str, ...]
    zig_link_flags: tuple[str, ...] = ()
    host: str = ""

    def folder(self, fmi: FmiVersion) -> str:
        """Folder below ``binaries/``; in FMI 3.0 the platform tuple, which names the processor on every machine."""
        processor, system = self.zig_target.split("-")[:2]
        return self.name if fmi == "2" else f"{processor}-{'darwin' if system.startswith('macos') else system}"


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

_EXPORTS = ("malloc", "free")
WASM = Platform(
    "wasm32",
    ".wasm",
    "wasm32-wasi",
    (),
    (
        "-mexec-model=reactor",
        "-s",
        "-Wl,--gc-sections",
        "-Wl,--export-dynamic",
        *(f"-Wl,--export={name}" for name in _EXPORTS),
    ),
    host="wasm",
)
"""WebAssembly, for pages and Node: a module without imports, which isn't part of an FMU but has a folder of its own."""

_SYSTEMS = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}
_X86, _ARM = ("x86_64", "amd64"), ("aarch64", "arm64")
"""Names of the processors."""

_ARM_TARGETS = {
    "linux64": PLATFORMS["aarch64-linux"].zig_target,
    "win64": "aarch64-windows-gnu",
    "darwin64": PLATFORMS["aarch64-darwin"].zig_target,
}


def native_platform() -> Platform:
    """The platform of this interpreter, with the name that FMI 2.0 importers on this machine use.

    Most importers (fmpy among them) ignore the processor, so on ARM the x86 names denote ARM binaries.

    Raises:
        PlatformError: FMI 2.0 has no name for this machine.
    """
    name, processor = _SYSTEMS.get(sys.platform), platform.machine().lower()
    if name is None or processor not in (*_X86, *_ARM) or sys.maxsize <= 2**32:
        where = f"{sys.platform} on {platform.machine()}"
        raise PlatformError(f"FMI 2.0 has no platform for {where}; build on one of {', '.join(PLATFORMS)}")
    return replace(PLATFORMS[name], zig_target=_ARM_TARGETS[name]) if processor in _ARM else PLATFORMS[name]


def find_platforms(names: Iterable[str] | None) -> tuple[Platform, ...]:
    """Platforms by name, sorted and unique; the native platform if there are no names. ``wasm32`` stands alone.

    Names have the meaning of the standard on every machine: ``linux64`` is x86.

    Raises:
        PlatformError: a name is unknown, or ``wasm32`` isn't alone.
    """
    wanted = sorted(set(names or ()))
    if wanted == [WASM.name]:
        return (WASM,)
    if WASM.name in wanted:
        raise PlatformError(f"{WASM.name} is no part of an FMU: build it by itself, without {', '.join(wanted[:-1])}")
    unknown = [name for name in wanted if name not in PLATFORMS]
    if unknown:
        raise PlatformError(f"unknown platform '{unknown[0]}'; choose from {', '.join(PLATFORMS)}, {WASM.name}")
    return tuple(PLATFORMS[name] for name in wanted) or (native_platform(),)


SOLVER_FOLDERS = ("base", "inputs", "math", "lanes", "solver")
"""Folders of the C runtime that the solver needs."""

RUNTIME_FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic")
"""Flags for the hand-written runtime; only CI adds -Werror, since newer compilers have more warnings."""

GENERATED_FLAGS = ("-std=c99", "-O2", "-w")
"""Flags for generated code, without warnings, since they would concern CasADi."""

COMMON_FLAGS = (
    "-fvisibility=hidden",  # export only the FMI functions
    "-ffp-contract=off",  # the same rounding on every machine
    "-fno-math-errno",  # sqrt is an instruction, not a call
    "-g0",  # no paths of the build folder
    "-ffunction-sections",
    "-fdata-sections",
)

FIRST_HEADER = ("-include", "old_glibc.h")
"""Flags that include this header first in every source of an FMU, so that binaries run with an old glibc."""

FMI_HEADERS: Mapping[FmiVersion, tuple[str, ...]] = {
    "2": ("fmi2TypesPlatform.h", "fmi2FunctionTypes.h", "fmi2Functions.h"),
    "3": ("fmi3PlatformTypes.h", "fmi3FunctionTypes.h", "fmi3Functions.h"),
}
"""Headers of the FMI standard."""

_COMPILERS = (("cc",), ("gcc",), ("clang",))
_REMEDY = "install gcc or clang, or run: pip install flexfmu[zig]"


@dataclass(frozen=True)
class CompileJob:
    """Compilation of one C file to one object file, both relative to the build folder."""

    source: str
    flags: tuple[str, ...]

    @property
    def object_file(self) -> str:
        """Name of the object file."""
        return f"{Path(self.source).stem}.o"


@dataclass(frozen=True)
class Compiler:
    """A C compiler for one platform.

    Attributes:
        command: command with arguments.
        executable: file whose modification time and size identify the version.
        platform: target platform.
    """

    command: tuple[str, ...]
    executable: Path
    platform: Platform

    def identity(self) -> str:
        """Text that identifies the compiler and its version: command, file, modification time and size."""
        facts = self.executable.stat()
        return f"{self.command} {self.executable} {facts.st_mtime_ns} {facts.st_size}"

    def compile(self, jobs: Iterable[CompileJob], folder: Path) -> None:
        """Compile all jobs in parallel.

        Args:
            jobs: C files to compile.
            folder: folder of sources and object files.

        Raises:
            CompileError: the compiler fails; the message contains its first error line.
        """
        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for _ in pool.map(lambda job: self._compile_one(job, folder), jobs):
                pass

    def link(self, objects: Iterable[str], library: str, folder: Path) -> None:
        """Link ``objects`` into the shared library ``library``, both relative to ``folder``.

        Raises:
            CompileError: the linker fails.
        """
        _run((*self.command, *objects, "-o", library, *self.platform.link_flags), folder, f"linking {library}")

    def _compile_one(self, job: CompileJob, folder: Path) -> None:
        flags = (*COMMON_FLAGS, *self.platform.compile_flags, *job.flags)
        _run((*self.command, *flags, "-c", job.source, "-o", job.object_file), folder, f"compiling {job.source}")


def fmi_header_folder() -> Path:
    """Folder with the standard's headers; fmpy brings them along, and isn't imported for it."""
    spec = importlib.util.find_spec("fmpy")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).with_name("c-code")


def find_compiler(platform: Platform) -> Compiler:
    """Find a C compiler: the variable CC, else cc, gcc, clang or zig; for cross-compilation only zig.

    Raises:
        MissingCompilerError: there is none; the message says what to install.
    """
    is_native = platform.zig_target == native_platform().zig_target
    compiler = _native_compiler(platform) if is_native else None
    compiler = compiler or _zig_compiler(platform)
    # error with remedy
    if compiler is None:
        where = "" if is_native else f" for {platform.name} on {native_platform().name}"
        remedy = _REMEDY if is_native else "run: pip install flexfmu[zig]"
        raise MissingCompilerError(f"no C compiler found{where}; {remedy}")
    return compiler


def _native_compiler(platform: Platform) -> Compiler | None:
    chosen = tuple(shlex.split(os.environ.get("CC", "")))
    for command in (chosen,) if chosen else _COMPILERS:
        executable = shutil.which(command[0])
        if executable is not None:
            return Compiler(command, Path(executable).resolve(), platform)
    if chosen:
        raise MissingCompilerError(f"C compiler '{chosen[0]}' of the variable CC not found; correct CC or unset it")
    return None


def _zig_compiler(platform: Platform) -> Compiler | None:
    spec = importlib.util.find_spec("ziglang")
    if spec is None or not spec.submodule_search_locations:
        return None
    command = (sys.executable, "-m", "ziglang", "cc", "-target", platform.zig_target)
    flags = (*platform.link_flags, "-O2", *platform.zig_link_flags)  # -O2 also applies to zig's own parts of a library
    return Compiler(command, Path(spec.submodule_search_locations[0]), replace(platform, link_flags=flags))


_UNDEFINED = re.compile(
    r"undefined (?:reference to|symbol:?) [`'\"]?([\w.$]+)|^\s*\"_(\w+)\", referenced from", re.MULTILINE
)
"""What GNU's linker, LLVM's and Apple's say of a symbol that nothing defines."""

_REASON = re.compile(r"error|multiple definition|duplicate symbol|cannot find", re.IGNORECASE)
_NO_REASON = re.compile(r"ld returned \d+ exit status|linker command failed")


def _run(command: tuple[str, ...], folder: Path, what: str) -> None:
    environment = os.environ | {"LC_ALL": "C"}
    try:
        outcome = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, errors="replace", check=False
        )
    except OSError as error:
        raise CompileError(f"{what}: cannot start {command[0]}: {error.strerror}; {_REMEDY}") from error
    if outcome.returncode != 0:
        output = outcome.stderr + outcome.stdout
        undefined = tuple(dict.fromkeys(one or other for one, other in _UNDEFINED.findall(output)))
        reason = f"nothing defines {', '.join(undefined)}" if undefined else _first_error(output)
        raise CompileError(f"{what} with {command[0]} failed: {reason}", undefined)


def _first_error(output: str) -> str:
    """The first line of compiler output that contains "error" or tells what a linker refuses, else the first line."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    said = [line for line in lines if not _NO_REASON.search(line)]
    return next((line for line in said if _REASON.search(line)), (said or lines or ["no message"])[0])
