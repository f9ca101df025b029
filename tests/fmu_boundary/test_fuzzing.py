"""Drawn sequences of FMI calls under the sanitizers, each call judged by what the standard and the FMU promise.

`make fuzz` runs 100 000 sequences of each, more than 10^7 calls; FLEXFMU_FUZZ sets another number. A sequence that fails is repeated with
``FUZZ_TRACE=1 program 1 NUMBER``.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from boundary_support.harness import ADDRESS, COMPILER, build, has_sanitizer, run
from boundary_support.subjects import FILES, SUBJECTS

SEQUENCES = int(os.environ.get("FLEXFMU_FUZZ", "500"))
FEWER = 20
FUZZER = ("tape.c", "fuzzed_calls.c", "fuzz.c", "fuzz_main.c")

pytestmark = [pytest.mark.slow, pytest.mark.skipif(COMPILER is None, reason="no C compiler")]


@pytest.mark.parametrize("name", SUBJECTS)
def test_no_sequence_of_calls_breaks_a_promise(name: str, tmp_path: Path) -> None:
    """Illegal orders, odd arguments, spoilt states and rollbacks: the right status and a sentence, never a crash, a hang,
    a silent NaN, a leak, or a reset instance that runs otherwise than a new one."""
    flags = ADDRESS if has_sanitizer("address,undefined", tmp_path) else ("-O2",)
    program = build(tmp_path, SUBJECTS[name](), FUZZER, flags)
    done = run(program, SEQUENCES, seconds=7200.0)
    print(f"{name}: {done}", end="")
    assert done.startswith(f"{SEQUENCES} sequences, ")


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="no valgrind")
@pytest.mark.parametrize("name", FILES)
def test_valgrind_finds_nothing(name: str, tmp_path: Path) -> None:
    """It alone sees numbers that are used before they are set: the importer's memory here is dirty."""
    program = build(tmp_path, SUBJECTS[name](), FUZZER, ("-O1", "-g"))
    options = ("--quiet", "--error-exitcode=9", "--leak-check=full", "--errors-for-leak-kinds=all")
    assert run("valgrind", *options, program, FEWER).startswith(f"{FEWER} sequences, ")
