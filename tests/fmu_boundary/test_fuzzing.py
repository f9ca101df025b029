"""Drawn sequences of FMI calls under the sanitizers, each call judged by what the standard and the FMU promise.

`make fuzz` runs 100 000 sequences of each, more than 10^7 calls; FLEXFMU_FUZZ sets another number. A sequence that fails is repeated with
``FUZZ_TRACE=1 program 1 NUMBER``.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from boundary_support.subjects import FILES, SUBJECTS, subject
from object_files import COMPILER, object_files, program, run

from flexfmu.fmu_build.sources import c_files
from flexfmu.fmu_build.toolchain import FmiVersion

SEQUENCES = int(os.environ.get("FLEXFMU_FUZZ", "100"))
FEWER = 20
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wno-type-limits")  # zero inputs make comparisons trivial
ADDRESS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not COMPILER, reason="no C compiler")]


def has_sanitizers(folder: Path) -> bool:
    """Whether the compiler can build and start a program under the sanitizers."""
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    try:
        run(program(folder, [folder / "empty.c"], *ADDRESS))
    except AssertionError:
        return False
    return True


def fuzzer(folder: Path, name: str, fmi: FmiVersion, *flags: str) -> Path:
    """The program that fuzzes a subject; hand-written files compile without a warning."""
    sources, counts = subject(name, fmi)
    counts = counts if fmi == "2" else (*counts, 0, 0)[:6]
    fuzz = Path(__file__).with_name("fuzz.c" if fmi == "2" else "fuzz3.c")
    for file, text in (sources.runtime | sources.generated).items():
        (folder / file).write_text(text, encoding="utf-8")
    names = ("N_INPUTS", "N_SETTABLE", "N_REALS", "N_INTEGERS", "N_STATES", "N_INDICATORS")
    numbers = [f"-D{each}={count}" for each, count in zip(names, counts, strict=False)]
    here = Path(__file__).parent
    options = ("-std=c99", "-ffp-contract=off", f"-I{folder}", f"-I{here.parent / 'c-runtime'}", *flags)
    # steps that have no end are given up early
    options += (f'-DGUID="{sources.guid}"', *numbers, "-DFLEX_MAX_STEPS=3000.0", "-DFLEX_MAX_SAMPLES=3000.0")
    own, generated = ([folder / file for file in c_files(files)] for files in (sources.runtime, sources.generated))
    objects = object_files(folder, [*own, fuzz], *options, *STRICT)
    return program(folder, [*objects, *object_files(folder, generated, *options, "-w")], *flags)


@pytest.mark.parametrize("fmi", ["2", "3"])
@pytest.mark.parametrize("name", SUBJECTS)
def test_no_sequence_of_calls_breaks_a_promise(name: str, fmi: FmiVersion, tmp_path: Path) -> None:
    """Illegal orders, odd arguments, spoilt states and rollbacks: the right status and a sentence, never a crash, a hang,
    a silent NaN, a leak, or a reset instance that runs otherwise than a new one."""
    flags = ADDRESS if has_sanitizers(tmp_path) else ("-O2",)
    done = run(fuzzer(tmp_path, name, fmi, *flags), SEQUENCES, seconds=7200.0)
    print(f"{name}: {done}", end="")
    assert done.startswith(f"{SEQUENCES} sequences")


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="no valgrind")
@pytest.mark.parametrize("name", FILES)
def test_valgrind_finds_nothing(name: str, tmp_path: Path) -> None:
    """It alone sees numbers that are used before they are set: the importer's memory here is dirty."""
    options = ("--quiet", "--error-exitcode=9", "--leak-check=full", "--errors-for-leak-kinds=all")
    assert run("valgrind", *options, fuzzer(tmp_path, name, "2", "-O1", "-g"), FEWER).startswith(f"{FEWER} sequences, ")
