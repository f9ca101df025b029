"""What tools of others say about the FMU's memory and about two instances in two threads."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from boundary_support.harness import ADDRESS, COMPILER, THREAD, build, has_sanitizer, run
from boundary_support.subjects import SUBJECTS

CYCLES, FEWER = 500, 50
CHOSEN = ("robot", "block", "trajectory")

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


@pytest.mark.slow
@pytest.mark.parametrize("name", CHOSEN)
def test_cycles_leak_nothing(name: str, tmp_path: Path) -> None:
    """A tool that makes an instance for every parameter set would run out of memory."""
    if not has_sanitizer("address,undefined", tmp_path):
        pytest.skip("the compiler has no address sanitizer")
    program = build(tmp_path, SUBJECTS[name](), ("cycles.c",), ADDRESS)
    assert run(program, CYCLES, ASAN_OPTIONS="detect_leaks=1") == f"{CYCLES} cycles\n"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="no valgrind")
@pytest.mark.parametrize("name", CHOSEN)
def test_valgrind_finds_nothing(name: str, tmp_path: Path) -> None:
    """It alone sees numbers that are used before they are set: the importer's memory here is dirty."""
    program = build(tmp_path, SUBJECTS[name](), ("cycles.c",), ("-O1", "-g"))
    options = ("--quiet", "--error-exitcode=9", "--leak-check=full", "--errors-for-leak-kinds=all")
    assert run("valgrind", *options, program, FEWER) == f"{FEWER} cycles\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", CHOSEN)
def test_two_threads_do_not_touch_each_other(name: str, tmp_path: Path) -> None:
    """Masters step their FMUs in parallel; each must get what it gets alone, and share no memory that changes."""
    flags = THREAD if has_sanitizer("thread", tmp_path) else ("-O2",)
    program = build(tmp_path, SUBJECTS[name](), ("cycles.c",), flags)
    assert run(program, 1, "threads", TSAN_OPTIONS="halt_on_error=1") == "1 cycles\n"
