"""Compiles C sources to a shared library; object files are cached, so that another payload recompiles one small table."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.fmu_build import toolchain
from flexfmu.fmu_build.cache import content_hash, read_cached, store
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.temporary import temporary_folder

if TYPE_CHECKING:
    from flexfmu.fmu_build.sources import Sources

_SMALL_FILE, _SMALL_SIZE = "model_small_functions.c", 10_000
"""Name of the file that holds all small generated files for the compiler, and their length [characters]."""


def compile_library(
    sources: Sources,
    compiler: toolchain.Compiler,
    *,
    cache: bool = True,
    runtime_flags: tuple[str, ...] = toolchain.RUNTIME_FLAGS,
    generated_flags: tuple[str, ...] = toolchain.GENERATED_FLAGS,
) -> bytes:
    """Compile and link ``sources`` in a temporary folder; return the content of the shared library.

    Args:
        sources: C files and headers.
        compiler: compiler for the platform.
        cache: whether to use cached object files with the same source, headers, flags and compiler.
        runtime_flags, generated_flags: compiler flags for the runtime and for generated code.

    Raises:
        CompileError: the compiler or linker fails.
        ArchiveError: the temporary files can't be written.
    """
    # one job per C file, with flags for generated code or runtime
    generated = _with_small_ones_joined(sources)
    texts = generated | sources.runtime
    first = toolchain.FIRST_HEADER if toolchain.FIRST_HEADER[-1] in texts else ()

    jobs = []
    for name in sorted(name for name in texts if name.endswith(".c")):
        flags = generated_flags if name in generated else runtime_flags
        lanes = toolchain.LANES_FLAGS if name == toolchain.SOLVER_LANES else ()
        jobs.append(toolchain.CompileJob(name, (*flags, *lanes, *first)))
    library = f"{sources.model_identifier}{compiler.platform.suffix}"
    with _work_folder() as folder:
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8", newline="\n")
        # compile what is not cached, and cache it
        kept = {job: _kept_object(job, texts, compiler) for job in jobs}
        missing = []
        for job, name in kept.items():
            if cache and (content := read_cached(name)) is not None:
                (folder / job.object_file).write_bytes(content)
            else:
                missing.append(job)
        compiler.compile(missing, folder)
        for job in missing:
            with suppress(ArchiveError):  # the build doesn't need the cache
                store(kept[job], (folder / job.object_file).read_bytes())
        beside = _stand_ins(sources, compiler, folder)
        compiler.link([*(job.object_file for job in jobs), *beside], library, folder)
        return (folder / library).read_bytes()


def _stand_ins(sources: Sources, compiler: toolchain.Compiler, folder: Path) -> tuple[str, ...]:
    """Arguments of the linker for shared libraries that lie beside this one.

    It is linked with empty libraries of their names, since the name that a library was built with, its SONAME, may be another one.
    """
    for name, each in sources.libraries.items():
        job = toolchain.CompileJob(f"{Path(name).stem}.c", toolchain.GENERATED_FLAGS)
        (folder / job.source).write_text(f'__attribute__((visibility("default"))) void {each.function}(void) {{}}\n')
        compiler.compile([job], folder)
        compiler.link([job.object_file], name, folder)
    return (*sources.libraries, "-Wl,-rpath,$ORIGIN") if sources.libraries else ()


def _with_small_ones_joined(sources: Sources) -> dict[str, str]:
    """The generated files with the small ones in one: to start the compiler and read the headers takes longer than to compile these.

    The table with the GUID stays by itself, since another payload changes it alone; and so does everything without a GUID.
    """
    small = [
        name
        for name, text in sorted(sources.generated.items())
        if name.endswith(".c") and len(text) < _SMALL_SIZE and sources.guid not in text
    ]
    others = {name: text for name, text in sources.generated.items() if name not in small}
    return others | ({_SMALL_FILE: "\n".join(sources.generated[name] for name in small)} if small else {})


@contextmanager
def _work_folder() -> Iterator[Path]:
    """A temporary folder; errors of the file system become an `ArchiveError`."""
    try:
        with temporary_folder("build") as name:
            yield Path(name)
    except OSError as error:
        remedy = "free some space, or name another folder in the variable TMPDIR"
        raise ArchiveError(f"cannot compile in a temporary folder: {error.strerror}; {remedy}") from error


def _kept_object(job: toolchain.CompileJob, texts: dict[str, str], compiler: toolchain.Compiler) -> str:
    """Name of a job's object file in the cache, a hash of source, all headers, files it includes, flags and compiler."""
    source = texts[job.source]
    read = [text for name, text in sorted(texts.items()) if name.endswith(".h") or f'#include "{name}"' in source]
    parts = (compiler.identity(), repr(job), compiler.platform.name, source, *read)
    return f"objects/{content_hash(part.encode() for part in parts)}.o"
