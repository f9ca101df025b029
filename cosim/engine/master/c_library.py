"""The C library of the master: compiled once on a machine, loaded once in a process."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CDLL, POINTER, byref, c_int, c_size_t
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from flexfmu.cosim.engine.master.instructions import CProgram, CProgress
from flexfmu.fmu_build.cache import cached, content_hash, store
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.errors import BuildError
from flexfmu.fmu_build.platforms import native_platform
from flexfmu.fmu_build.toolchain import Compiler, find_compiler

RunProgram = Callable[[CProgram, int, CProgress], int]
"""Runs a program until so many steps are completed; returns 0, or 1 if an instruction failed."""


@cache
def load() -> RunProgram | None:
    """The C function that runs programs; None if it can't be compiled or loaded, for example without a C compiler."""
    try:
        # compile on the first use on this machine
        library = CDLL(str(_library()))
    except (BuildError, OSError):
        return None
    function: Any = library.master_run
    function.argtypes = (POINTER(CProgram), c_size_t, POINTER(CProgress))
    function.restype = c_int
    return lambda program, points, progress: int(function(byref(program), points, byref(progress)))


def _library() -> Path:
    """Path of the shared library; it is cached under the hash of its sources and the compiler."""
    folder = files("flexfmu.cosim.engine.master").joinpath("c-master")
    texts = {file.name: file.read_text(encoding="utf-8") for file in folder.iterdir() if file.name[-2:] in (".c", ".h")}
    platform = native_platform()
    compiler = find_compiler(platform)
    key = content_hash(part.encode() for part in (compiler.identity(), *(t for _, t in sorted(texts.items()))))
    file = f"master/{key}{platform.suffix}"
    return cached(file) or store(file, _compile(texts, compiler))


def _compile(texts: dict[str, str], compiler: Compiler) -> bytes:
    """Content of the shared library. The import is local because it loads CasADi, which only compilation needs."""
    from flexfmu.fmu_build.sources import Sources

    return compile_library(Sources("flexfmu_master", "", "", {}, texts, {}), compiler)
