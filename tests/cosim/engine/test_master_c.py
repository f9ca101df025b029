"""The loop in C by itself: compiled without a warning, every instruction, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import shutil
import subprocess
from importlib.resources import as_file, files
from pathlib import Path

import pytest

COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
SANITIZERS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SOURCE, DENSE = (Path(__file__).parent / "c-master" / name for name in ("program.c", "dense_program.c"))


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize("failing", [[], ["step"]], ids=["not finite", "failed step"])
def test_all_instructions(failing: list[str], tmp_path: Path) -> None:
    """What they write, when they are carried out, and where a failure is reported."""
    program = tmp_path / "program"
    with as_file(files("flexfmu.cosim.engine.master") / "c-master") as folder:
        command = [COMPILER, *FLAGS, *SANITIZERS, "-I", folder, SOURCE, folder / "master.c", "-o", program]
        built = subprocess.run([str(each) for each in command], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    outcome = subprocess.run([program, *failing], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_interpolation_stays_within_its_arrays(tmp_path: Path) -> None:
    """All derivatives of two signals, at a point and between the last ones."""
    program = tmp_path / "program"
    with as_file(files("flexfmu.cosim.engine.master") / "c-master") as folder:
        command = [COMPILER, *FLAGS, *SANITIZERS, "-I", folder, DENSE, folder / "dense.c", "-o", program]
        built = subprocess.run([str(each) for each in command], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    outcome = subprocess.run([program], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
