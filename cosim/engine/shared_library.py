"""C libraries of this package: compiled once on a machine, cached under the hash of sources and compiler."""

from __future__ import annotations

from ctypes import CDLL
from importlib.resources import files
from pathlib import Path

from flexfmu.fmu_build.cache import cached, content_hash, store
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.errors import BuildError
from flexfmu.fmu_build.toolchain import Compiler, find_compiler, native_platform


def shared_library(package: str, folder: str) -> CDLL:
    """Load the library of the C files in a package's folder, compiled on its first use on this machine.

    Raises:
        BuildError: it can't be compiled or loaded, for example without a C compiler.
    """
    try:
        return CDLL(str(_library(package, folder)))
    except OSError as error:
        raise BuildError(f"can't load the library of {package}/{folder}: {error}") from None


def _library(package: str, folder: str) -> Path:
    """Path of the shared library in the cache."""
    found = files(package).joinpath(folder)
    texts = {file.name: file.read_text(encoding="utf-8") for file in found.iterdir() if file.name[-2:] in (".c", ".h")}
    platform = native_platform()
    compiler = find_compiler(platform)
    key = content_hash(part.encode() for part in (compiler.identity(), *(t for _, t in sorted(texts.items()))))
    file = f"{folder.removeprefix('c-')}/{key}{platform.suffix}"
    return cached(file) or store(file, _compile(folder, texts, compiler))


def _compile(folder: str, texts: dict[str, str], compiler: Compiler) -> bytes:
    """Content of the shared library. The import is local because it loads CasADi, which only compilation needs."""
    from flexfmu.fmu_build.sources import Sources

    return compile_library(Sources(f"flexfmu_{folder.removeprefix('c-')}", "", "", {}, texts, {}), compiler)
