"""C libraries of this package: compiled once on a machine, cached under the hash of sources and flags.

A library that is in the cache needs no compiler, like an FMU that is there; a scene's FMU is built together with those that runs of
scenes need.
"""

from __future__ import annotations

from collections.abc import Mapping
from ctypes import CDLL
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from flexfmu.fmu_build.c_header import structures, typed
from flexfmu.fmu_build.cache import cached, content_hash, store
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.errors import BuildError
from flexfmu.fmu_build.sources import Sources, c_files
from flexfmu.fmu_build.toolchain import COMMON_FLAGS, RUNTIME_FLAGS, SOLVER_FOLDERS, find_compiler, native_platform

LIBRARIES = {
    "master": ("flexfmu.cosim.engine.master", "c-master"),
    "metrics": ("flexfmu.cosim.metrics", "c-metrics"),
    "live": ("flexfmu.cosim.exchange", "c-live"),
    "exchange": ("flexfmu.fmu_build", *(f"c-runtime/{each}" for each in (*SOLVER_FOLDERS, "import"))),
}
"""Package of each library, and the folders of its C files there; the last one has the header of what it exports."""


@cache
def c_structures(name: str) -> Mapping[str, Any]:
    """The structures of a library's headers by name."""
    return structures(_header(name))


def _header(name: str) -> str:
    """The text of the headers with what a library exports."""
    package, *_, last = LIBRARIES[name]
    return "\n".join(text for file, text in sorted(_texts(package, last).items()) if file.endswith(".h"))


def library_texts(name: str) -> dict[str, str]:
    """File → text of a library's C files and headers."""
    return _texts(*LIBRARIES[name])


def _texts(package: str, *folders: str) -> dict[str, str]:
    """File → text of the C files and headers of a package's folders."""
    entries = (entry for folder in folders for entry in files(package).joinpath(folder).iterdir())
    return {entry.name: entry.read_text(encoding="utf-8") for entry in entries if entry.name[-2:] in (".c", ".h")}


@cache
def shared_library(name: str) -> Any:
    """Load a library, compiled on its first use on this machine; its functions have the signatures of its headers.

    Raises:
        BuildError: it can't be compiled or loaded, for example without a C compiler.
    """
    try:
        return typed(CDLL(str(library_file(name))), _header(name), c_structures(name))
    except OSError as error:
        raise BuildError(f"can't load the library {name} of {LIBRARIES[name][0]}: {error}") from None


def library_file(name: str) -> Path:
    """Path of a library in the cache, compiled where it is missing.

    Raises:
        BuildError: it can't be compiled.
    """
    platform, texts = native_platform(), library_texts(name)
    parts = (platform.name, *COMMON_FLAGS, *RUNTIME_FLAGS, *(text for _, text in sorted(texts.items())))
    file = f"{name}/{content_hash(part.encode() for part in parts)}{platform.suffix}"
    if (path := cached(file)) is not None:
        return path
    sources = Sources(f"flexfmu_{name}", "", "", {}, texts, {}, joined=c_files(texts))
    return store(file, compile_library(sources, find_compiler(platform)))
