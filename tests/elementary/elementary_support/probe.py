"""The elementary functions of the C runtime, called through a small program."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]
Call = tuple[str, float, float]
Evaluate = Callable[[Sequence[Call]], Array]

RUNTIME = Path(__file__).parents[3] / "fmu_build" / "c-runtime" / "math"
SOURCES = [Path(__file__).with_name("probe.c"), *sorted(RUNTIME.glob("elementary_*.c"))]
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off", "-fno-math-errno")
COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)


def digits(calls: Sequence[Call]) -> str:
    """What the program reads: one call a line, numbers as the digits of their bits."""
    bits = np.array([call[1:] for call in calls], dtype=float).view(np.uint64)
    return "\n".join(f"{name} {x:016x} {y:016x}" for (name, _, _), (x, y) in zip(calls, bits.tolist(), strict=True))


def results_of(program: Path, calls: Sequence[Call], emulator: Sequence[str] = ()) -> Array:
    """Result of each call, one after the other."""
    outcome = subprocess.run([*emulator, program], input=digits(calls), capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    return np.array([int(word, 16) for word in outcome.stdout.split()], dtype=np.uint64).view(float)


def build_probe(folder: Path, flags: Sequence[str]) -> Path:
    """The program."""
    if COMPILER is None:
        pytest.skip("no C compiler")
    program = folder / "probe"
    subprocess.run(
        [COMPILER, *FLAGS, *flags, f"-I{RUNTIME}", f"-I{RUNTIME.parent / 'lanes'}", *SOURCES, "-o", program, "-lm"],
        check=True,
    )
    return program
