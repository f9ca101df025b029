"""The C compiler: finding one, compiling side by side, linking a shared library. The package's only subprocess."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from flexfmu.fmu_build.errors import CompileError, MissingCompilerError
from flexfmu.fmu_build.platforms import Platform, native_platform

RUNTIME_FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic")
"""The hand-written runtime has no warnings; CI adds -Werror, a user's newer compiler may know more of them."""

GENERATED_FLAGS = ("-std=c99", "-O2", "-w")
"""Generated code: straight-line arithmetic, not meant to be read; warnings would be about CasADi."""

COMMON_FLAGS = (
    "-fvisibility=hidden",  # nothing but the FMI functions is exported
    "-ffp-contract=off",  # the same roundings on every machine
    "-fno-math-errno",  # sqrt is an instruction, not a call
    "-g0",  # nothing about the folder in which it was compiled
    "-ffunction-sections",
    "-fdata-sections",
)

FIRST_HEADER = ("-include", "old_glibc.h")
"""Read in front of every source of an FMU, so that binaries for Linux need no new C library."""

_COMPILERS = (("cc",), ("gcc",), ("clang",))
_REMEDY = "install gcc or clang, or run: pip install flexfmu[zig]"


@dataclass(frozen=True)
class CompileJob:
    """One C file → one object file, both relative to the build folder."""

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
        command: how it is called, arguments included.
        executable: the file that does the work; another version of it is another compiler.
        platform: what it compiles for.
    """

    command: tuple[str, ...]
    executable: Path
    platform: Platform

    def identity(self) -> str:
        """What distinguishes this compiler from another one or from its next version: command, file, time and size."""
        facts = self.executable.stat()
        return f"{self.command} {self.executable} {facts.st_mtime_ns} {facts.st_size}"

    def compile(self, jobs: Iterable[CompileJob], folder: Path) -> None:
        """Compile all jobs in ``folder``, as many at once as there are processors, the largest source first.

        Args:
            jobs: what to compile.
            folder: where the sources are and the objects go.

        Raises:
            CompileError: the compiler refuses a file; its first error line is in the message.
        """
        ordered = sorted(jobs, key=lambda job: (folder / job.source).stat().st_size, reverse=True)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for _ in pool.map(lambda job: self._compile_one(job, folder), ordered):
                pass

    def link(self, objects: Iterable[str], library: str, folder: Path) -> None:
        """Link ``objects`` into the shared library ``library``, both relative to ``folder``.

        Raises:
            CompileError: the linker refuses.
        """
        _run((*self.command, *objects, "-o", library, *self.platform.link_flags), folder, f"linking {library}")

    def _compile_one(self, job: CompileJob, folder: Path) -> None:
        flags = (*COMMON_FLAGS, *self.platform.compile_flags, *job.flags)
        _run((*self.command, *flags, "-c", job.source, "-o", job.object_file), folder, f"compiling {job.source}")


def find_compiler(platform: Platform) -> Compiler:
    """A C compiler for ``platform``: the variable CC, cc, gcc, clang, then zig; for other platforms zig alone.

    Raises:
        MissingCompilerError: there is none; the message says what to install.
    """
    is_native = platform.zig_target == native_platform().zig_target
    compiler = _native_compiler(platform) if is_native else None
    compiler = compiler or _zig_compiler(platform)
    # what is missing, and how to get it
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
    flags = (*platform.link_flags, "-O2", *platform.zig_link_flags)  # also how zig compiles its own parts of a library
    return Compiler(command, Path(spec.submodule_search_locations[0]), replace(platform, link_flags=flags))


def _run(command: tuple[str, ...], folder: Path, what: str) -> None:
    environment = os.environ | {"LC_ALL": "C"}
    try:
        outcome = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, errors="replace", check=False
        )
    except OSError as error:
        raise CompileError(f"{what}: cannot start {command[0]}: {error.strerror}; {_REMEDY}") from error
    if outcome.returncode != 0:
        raise CompileError(f"{what} with {command[0]} failed: {_first_error(outcome.stderr + outcome.stdout)}")


def _first_error(output: str) -> str:
    """The first line with an error, else the first line."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    return next((line for line in lines if "error" in line.lower()), lines[0] if lines else "no message")
