"""The same bits on every platform: each binary runs in a small C program, under an emulator where it is a foreign one; and an
FMU's sources are all that it takes to build it again, with whatever compiler there is.

Operations are neither contracted nor reordered, and the elementary functions are our own.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmpy.build import build_platform_binary
from fmpy.model_description import read_build_description
from numpy.typing import NDArray

from flexfmu.fmu_build.sources import Sources

Array = NDArray[np.float64]
Run = Callable[..., Array]

ARM_SYSTEM = Path("/usr/aarch64-linux-gnu")
"""The ARM C library, of Debian's package libc6-arm64-cross."""

EMULATORS = {"linux64": (), "win64": ("wine",), "aarch64-linux": ("qemu-aarch64", "-L", str(ARM_SYSTEM))}


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
@pytest.mark.parametrize("name", EMULATORS)
def test_platforms_give_the_same_bits(name: str, run: Run, native: Array) -> None:
    """Without contraction and reordering of floating-point operations a compiler has no choice: GCC and Clang agree, Windows
    with Linux, and ARM, which could fuse multiplications and additions, with x86."""
    emulator = EMULATORS[name]
    for program in ("cc", *emulator[:1]):
        if shutil.which(program) is None:
            pytest.skip(f"needs {program}")
    if name == "aarch64-linux" and not ARM_SYSTEM.is_dir():
        pytest.skip("needs libc6-arm64-cross")
    np.testing.assert_array_equal(run(name, emulator, with_zig=True), native)


@pytest.fixture
def unpacked(tmp_path: Path, robot_sources: Sources) -> Path:
    """The FMU without any binary, unpacked."""
    folder = tmp_path / "fmu"
    for path, content in robot_sources.archive_files().items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    return folder


def test_build_description_lists_every_source(unpacked: Path, robot_sources: Sources) -> None:
    """It passes the schema of FMI 3.0, from which it is, and nothing is forgotten or invented."""
    (configuration,) = read_build_description(str(unpacked))
    assert configuration.modelIdentifier == robot_sources.model_identifier
    (file_set,) = configuration.sourceFileSets
    assert set(file_set.sourceFiles) == {path.name for path in (unpacked / "sources").glob("*.c")}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs cc")
def test_one_line_of_the_compiler_builds_the_same_numbers(unpacked: Path, native: Array, run: Run) -> None:
    """The documentation's own line, without our build and its flags, gives every bit of the outputs again."""
    page = (unpacked / "documentation" / "index.html").read_text(encoding="utf-8")
    line = next(line for line in page.splitlines() if "<code>cc " in line)
    command = line.split("<code>")[1].split("</code>")[0]
    subprocess.run(command, shell=True, cwd=unpacked, check=True)
    np.testing.assert_array_equal(run("linux64", library=unpacked / "model.so"), native)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs cmake")
def test_fmpy_compiles_the_same_numbers(unpacked: Path, native: Array, run: Run, robot_sources: Sources) -> None:
    """`fmpy compile` finds all that it needs in the model description, and the numbers are the same to the last bit."""
    build_folder = unpacked / "build"
    build_folder.mkdir()
    build_platform_binary(unpacked, build_folder)
    library = unpacked / "binaries" / "linux64" / f"{robot_sources.model_identifier}.so"
    np.testing.assert_array_equal(run("linux64", library=library), native)
