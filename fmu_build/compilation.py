"""Compiles C sources to a shared library; object files are cached, so that another payload recompiles one small table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from flexfmu.fmu_build import toolchain
from flexfmu.fmu_build.cache import content_hash, read_cached, store
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.sources import Sources, folder_texts
from flexfmu.fmu_build.temporary import temporary_folder

_UNIT_SIZE = 100_000
"""Length of what is compiled as one [characters]; some units can be compiled in parallel."""

_SELDOM = ("derive", "error_scale", "initial_coordinates", "initial_inputs", "motion_forward", "start_forward")
"""Generated functions that are called at a start or for a linearisation: optimised less, which takes half the compiler's time."""


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
    # one job per unit, with flags for generated code or runtime
    # the table with the GUID stays by itself, since another payload changes it alone
    host = folder_texts(compiler.platform.host) if compiler.platform.host else {}
    runtime = _units(sources.runtime | host, lambda name: name not in sources.joined)
    seldom = {name for name in sources.generated if name.removeprefix("model_").removesuffix(".c") in _SELDOM}
    often, rest = (
        _units(
            {name: text for name, text in sources.generated.items() if (name in seldom) == is_seldom},
            lambda name: sources.guid in sources.generated[name],
        )
        for is_seldom in (False, True)
    )
    texts = sources.generated | sources.runtime | host | runtime | often | rest
    first = toolchain.FIRST_HEADER if toolchain.FIRST_HEADER[-1] in texts else ()
    flags_of = ((runtime, runtime_flags), (often, generated_flags), (rest, (*generated_flags, "-O1")))
    jobs = [toolchain.CompileJob(name, (*flags, *first)) for units, flags in flags_of for name in units]
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


def _units(texts: Mapping[str, str], separate: Callable[[str], bool]) -> dict[str, str]:
    """What the compiler gets, name → text: C files that include others, since to start it and read the headers takes longer than most.

    What is ``separate`` stays by itself, and so does what includes C files already.
    """
    units: dict[str, str] = {}
    unit, size = "", _UNIT_SIZE
    for name, text in sorted(texts.items()):
        if name.endswith(".h"):
            continue
        if separate(name) or '.c"\n' in text:
            units[name] = text
            continue
        if size + len(text) > _UNIT_SIZE:
            unit, size = f"unit_of_{name}", 0
        units[unit] = units.get(unit, "") + f'#include "{name}"\n'
        size += len(text)
    return units


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
