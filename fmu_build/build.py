"""Builds the FMU of a plant, a block or a motion, or takes it from the cache."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Literal, cast, get_args

from flexfmu.fmu_build.archive import fmu_facts, pack, write_atomically
from flexfmu.fmu_build.cache import cache_folder, content_hash, package_fingerprint, read_cached, store
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.errors import ArchiveError, BuildError, PlatformError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.naming import Naming
from flexfmu.fmu_build.toolchain import WASM, FmiVersion, Platform, find_compiler, find_platforms, native_platform
from flexfmu.model.symbolic import SymbolicBlock

if TYPE_CHECKING:  # a cached build avoids the import of CasADi (a quarter of a second)
    from flexfmu.fmu_build.sources import Sources
    from flexfmu.fmu_build.trajectory_build import Motion
    from flexfmu.model.symbolic import SymbolicModel

BuildProgress = Callable[[str], None]
"""Called with a short text at the beginning of each stage of a build."""

DEFAULT_SAMPLES = 1000
"""Length of a block's default experiment in samples."""

MOTION_STEP = 1e-3
"""Communication step of a motion's default experiment [s]."""


@dataclass(frozen=True)
class BuiltFmu:
    """A finished FMU.

    Attributes:
        path: path of the file.
        guid: hash of its content.
        cached: whether it comes from the cache.
        seconds: wall time of the build [s].
        code_bytes: size of the generated C code, without the runtime [bytes].
        fmu_bytes: size of the file [bytes].
    """

    path: Path
    guid: str
    cached: bool
    seconds: float
    code_bytes: int
    fmu_bytes: int


def build_fmu(
    model: SymbolicModel | SymbolicBlock | Motion | Callable[[], SymbolicModel],
    output: Path | None = None,
    *,
    key: str | None = None,
    platforms: Iterable[str] | None = None,
    step: float | None = None,
    tolerance: float = DefaultExperiment.tolerance,
    stop_time: float | None = None,
    naming: Naming = "structured",
    enumerations: bool = False,
    fmi: FmiVersion | Literal[2, 3] = "2",
    cache: bool = True,
    progress: BuildProgress = lambda message: None,
) -> BuiltFmu:
    """Build an FMU 2.0 or 3.0, unless an equal one is in the cache: of a plant for co-simulation and model exchange, of a block
    (`flexfmu.fmu_build.block_build`) or a motion (`flexfmu.fmu_build.trajectory_build`) for co-simulation.

    Args:
        model: what becomes an FMU, or a function that returns a plant, called only if the FMU must be built.
        output: file to write, for ``wasm32`` the folder of the module; None leaves the FMU in the cache.
        key: text that determines the model; the cache also considers the package's sources and the versions of flexfmu
            and CasADi. Without a key, the generated C code determines whether the FMU is in the cache.
        platforms: FMI 2.0 platform names, also for an FMU 3.0; None for this machine's. ``wasm32`` alone gives a WebAssembly module, see
            `flexfmu.fmu_build.wasm_module`.
        step: communication step [s] of the default experiment; None for a block's sample time, a millisecond for a motion.
        tolerance: relative tolerance of the default experiment, also used if the importer passes none.
        stop_time: end [s] of the default experiment; None for a thousand samples of a block, or the duration of a motion.
        naming: naming convention of the variables, see `flexfmu.fmu_build.naming`.
        enumerations: whether the parameters ``initial`` and ``integrator`` are FMI enumerations instead of Integers; not
            every importer accepts enumerations (Maestro 3.1.1 doesn't).
        fmi: version of FMI, as number or text.
        cache: False builds again and replaces the FMU in the cache.
        progress: called at the beginning of each stage.

    Raises:
        BuildError: the model violates its contract, no table reproduces the motion, the platform or version is unknown, there is no
            compiler, compilation fails, or a file can't be written.
    """
    started = perf_counter()
    if str(fmi) not in get_args(FmiVersion):
        raise BuildError(f"fmi is the version of the standard, '2' for FMI 2.0 or '3' for FMI 3.0, got {fmi!r:.60}")
    if naming not in get_args(Naming):
        raise BuildError(f"naming is structured or flat, got {naming!r:.60}")
    standard = cast(FmiVersion, str(fmi))
    targets = find_platforms(platforms)
    if targets == (WASM,) and standard != "2":
        raise PlatformError(f"{WASM.name} is built for FMI 2.0 alone; leave out --fmi")
    # the default experiment lasts as long as the motion, or a thousand samples
    usual_step, usual_end = DefaultExperiment.step, DefaultExperiment.stop_time
    if isinstance(model, SymbolicBlock):
        from flexfmu.fmu_build.block_build import regular_block

        model = regular_block(model)
        usual_step, usual_end = model.sample_time, DEFAULT_SAMPLES * model.sample_time
    elif hasattr(model, "trajectory"):
        usual_step, usual_end = MOTION_STEP, model.trajectory.duration
    end = float(f"{usual_end:.12g}") if stop_time is None else stop_time
    experiment = DefaultExperiment(end, usual_step if step is None else step, tolerance)

    # called only if the cache has no equal FMU
    def make_sources() -> Sources:
        from flexfmu.fmu_build.source_generation import generate_sources

        progress("building the model")
        symbolic = model() if callable(model) else model
        progress("generating C")
        return generate_sources(symbolic, experiment, naming, enumerations, standard)

    # without a key, the GUID is the key
    make = make_sources
    if key is None:
        sources = make_sources()
        key, make = sources.guid, lambda: sources
    else:
        key = f"{naming} {enumerations} {standard} {key}"

    # an intact FMU from the cache, or a new one
    versions = version("casadi"), version("flexfmu")
    parts = (key, package_fingerprint(), *versions, os.environ.get("CC", ""), repr(targets), repr(experiment))
    name = f"{content_hash(part.encode() for part in parts)}.fmu"
    stored = cache_folder() / name
    content = read_cached(name) if cache else None
    is_cached = content is not None
    if content is None:
        content = _build(make, targets, standard, cache, progress)
        stored = _keep(name, content, is_needed=output is None)
    if output is not None and targets == (WASM,):
        from flexfmu.fmu_build.wasm_module import write_module

        write_module(content, output)
    elif output is not None:
        write_atomically(output, content)

    # GUID and size of the code, read from the file
    guid, code_bytes = fmu_facts(content)
    return BuiltFmu(output or stored, guid, is_cached, perf_counter() - started, code_bytes, len(content))


def _keep(name: str, content: bytes, is_needed: bool) -> Path:
    """Write a built FMU into the cache and return its path; unless ``is_needed``, a failure to write is ignored."""
    try:
        return store(name, content)
    except ArchiveError as error:
        if is_needed:
            raise ArchiveError(f"{error}, name it in the variable FLEXFMU_CACHE, or give an output file") from error
        return cache_folder() / name


def _build(
    make_sources: Callable[[], Sources],
    platforms: tuple[Platform, ...],
    fmi: FmiVersion,
    cache: bool,
    progress: BuildProgress,
) -> bytes:
    compilers = [find_compiler(platform) for platform in platforms]  # fail early if a compiler is missing
    sources = make_sources()
    others = [each.name for each in platforms if sources.libraries and each.name != native_platform().name]
    if others:
        raise PlatformError(
            f"{', '.join(sources.libraries)} is for this machine; for {others[0]} give the C source instead"
        )
    files = sources.archive_files()
    for compiler in compilers:
        progress(f"compiling for {compiler.platform.name}")
        folder = f"binaries/{compiler.platform.folder(fmi)}"
        files[f"{folder}/{sources.model_identifier}{compiler.platform.suffix}"] = compile_library(
            sources, compiler, cache=cache
        )
        files |= {f"{folder}/{name}": each.content for name, each in sources.libraries.items()}
    progress("packing")
    return pack(files)
