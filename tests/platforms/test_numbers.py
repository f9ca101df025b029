"""The same bits on every platform: each binary runs in a small C program, under an emulator where it is a foreign one.

Operations are neither contracted nor reordered, and the elementary functions are our own.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]

ARM_SYSTEM = Path("/usr/aarch64-linux-gnu")
"""The ARM C library, of Debian's package libc6-arm64-cross."""

WINE = ("wine",)
QEMU = ("qemu-aarch64", "-L", str(ARM_SYSTEM))

Run = Callable[..., Array]


@pytest.fixture
def run(run_library: Callable[..., Array], write_library: Callable[..., Path]) -> Run:
    """Function that runs the robot's binary of a platform and gives its outputs, shape (steps, outputs)."""

    def run_on(name: str, emulator: tuple[str, ...] = (), with_zig: bool = False) -> Array:
        return run_library(write_library(name, with_zig), name, emulator)

    return run_on


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs cc")
def test_two_compilers_give_the_same_bits(run: Run, native: Array) -> None:
    """Without contraction and reordering of floating-point operations a compiler has no choice: GCC and Clang agree."""
    np.testing.assert_array_equal(run("linux64", with_zig=True), native)


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
def test_windows_agrees_with_linux(run: Run, native: Array) -> None:
    """A controller designed on one system acts on the same robot on the other."""
    if shutil.which("wine") is None:
        pytest.skip("needs wine")
    np.testing.assert_array_equal(run("win64", WINE), native)


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
def test_arm_agrees_with_x86(run: Run, native: Array) -> None:
    """ARM could fuse multiplications and additions, and must not."""
    if shutil.which("qemu-aarch64") is None:
        pytest.skip("needs qemu-aarch64, of qemu-user")
    if not ARM_SYSTEM.is_dir():
        pytest.skip("needs libc6-arm64-cross")
    np.testing.assert_array_equal(run("aarch64-linux", QEMU), native)
