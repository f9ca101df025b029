"""Compiles the solver of variants in lockstep from the sources of an FMU, with as many lanes as the processor has.

One library serves all variants of a model: a lane of every number for each variant (``c-runtime/base/real.h``). The generated C
code comes from the FMU, the runtime from this package.
"""

from __future__ import annotations

from collections.abc import Mapping
from ctypes import CDLL
from functools import cache
from pathlib import Path

from flexfmu.fmu_build.archive import files_in
from flexfmu.fmu_build.cache import cached, content_hash, store
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.sources import Sources, c_files, runtime_sources
from flexfmu.fmu_build.toolchain import GENERATED_FLAGS, RUNTIME_FLAGS, find_compiler, native_platform

LANE_FLAGS: Mapping[int, tuple[str, ...]] = {
    8: ("-mavx512f", "-mavx512dq", "-mprefer-vector-width=512"),
    4: ("-mavx2",),
    1: (),
}
"""Number of lanes → compiler flags for the registers that hold them."""

WORK = ("-DFLEX_WORK_AT_START=1e5", "-DFLEX_WORK_PER_STEP=200.0", "-DFLEX_WORK_PER_SECOND=1e6")
"""Evaluations of the equations that variants may make: some 50 times the usual number, where an FMU may make 10,000 times as many. A
variant that takes more leaves, and its FMU goes on alone."""

_FIRST = ("-include", "batch_functions.h")


@cache
def lanes_of_processor() -> int:
    """Lanes of the widest library that this processor can run: 8 with AVX-512, 4 with AVX2, otherwise 1.

    Raises:
        BuildError: there is no C compiler.
    """
    library = _compiled("flexfmu_processor", {}, runtime_sources("processor"), ("-fvisibility=default",))
    return int(CDLL(str(library)).flex_processor_lanes())


def batch_library(fmu: Path, lanes: int) -> Path:
    """The shared library that simulates variants of a plant's FMU in lockstep; compiled once, then from the cache.

    Args:
        fmu: FMU of the plant, with its sources.
        lanes: number of variants side by side, 1, 4 or 8.

    Raises:
        BuildError: the FMU has no sources, its functions branch, or there is no compiler.
    """
    generated = _generated_code(fmu)
    if branching := [name for name, code in generated.items() if "casadi_" in code]:
        raise ModelError(f"variants in lockstep need functions without branches, {branching[0]} has one")
    flags = (f"-DFLEX_WIDTH={lanes}", *LANE_FLAGS[lanes], *WORK)
    return _compiled("flexfmu_batch", generated, runtime_sources("batch"), flags)


def _generated_code(fmu: Path) -> dict[str, str]:
    """The generated C files of an FMU, name → text."""
    files, runtime = files_in(fmu, "sources"), runtime_sources()
    return {name: text.decode() for name, text in files.items() if name.startswith("model_") and name not in runtime}


def _compiled(name: str, generated: dict[str, str], runtime: dict[str, str], flags: tuple[str, ...]) -> Path:
    """Path of a library in the cache, under the hash of its sources, flags and compiler."""
    compiler = find_compiler(native_platform())
    texts = generated | runtime
    parts = (compiler.identity(), *flags, *(part for file in sorted(texts) for part in (file, texts[file])))
    file = f"batch/{content_hash(part.encode() for part in parts)}{compiler.platform.suffix}"
    if (found := cached(file)) is not None:
        return found
    sources = Sources(name, "", "", generated, runtime, {}, joined=c_files(runtime))
    runtime_flags, generated_flags = (*RUNTIME_FLAGS, *flags), (*GENERATED_FLAGS, *flags, *_FIRST)
    library = compile_library(sources, compiler, runtime_flags=runtime_flags, generated_flags=generated_flags)
    return store(file, library)
