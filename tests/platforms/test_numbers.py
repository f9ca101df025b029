"""The same numbers on every platform: each binary runs in a small C program, under an emulator where it is a foreign one."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from flexfmu.model.symbolic import SymbolicModel

Array = NDArray[np.float64]

AGREEMENT = 1e-12
"""Of platforms with different mathematics libraries, relative to each output's natural scale."""

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


def _natural_scale(model: SymbolicModel, outputs: Array) -> Array:
    """What one rounding of the coordinates makes of each output.

    For most outputs that is their largest value. A modal coordinate q follows the load almost statically: its second
    derivative is what remains of the difference between load and stiffness force, each omega² |q|, omega being the mode's
    own frequency.
    """
    parameters = [variable.start for variable in model.parameters]
    scale = np.array(model.functions["error_scale"](model.functions["derive"](parameters))).ravel()
    n = model.degrees_of_freedom
    omega = dict(zip(model.unknowns, np.sqrt(scale[:n] / scale[n : 2 * n]), strict=True))
    names = [variable.name for variable in model.outputs]
    largest = dict(zip(names, np.abs(outputs).max(axis=0), strict=True))
    for q in model.unknowns:
        for order, name in enumerate((f"der({q})", f"der({q},2)"), start=1):
            largest[name] = max(largest[name], omega[q] ** order * largest[q])
    return np.array([largest[name] for name in names])


def _difference(model: SymbolicModel, outputs: Array, reference: Array) -> float:
    return float(np.max(np.abs(outputs - reference) / _natural_scale(model, reference)))


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs cc")
def test_two_compilers_give_the_same_bits(run: Run, native: Array) -> None:
    """Without contraction and reordering of floating-point operations a compiler has no choice: GCC and Clang agree."""
    np.testing.assert_array_equal(run("linux64", with_zig=True), native)


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
def test_windows_agrees_with_linux(run: Run, native: Array, robot: SymbolicModel) -> None:
    """A controller designed on one system acts on the same robot on the other."""
    if shutil.which("wine") is None:
        pytest.skip("needs wine")
    assert _difference(robot, run("win64", WINE), native) < AGREEMENT


@pytest.mark.usefixtures("zig")
@pytest.mark.slow
def test_arm_agrees_with_x86(run: Run, native: Array, robot: SymbolicModel) -> None:
    """ARM could fuse multiplications and additions, and must not."""
    if shutil.which("qemu-aarch64") is None:
        pytest.skip("needs qemu-aarch64, of qemu-user")
    if not ARM_SYSTEM.is_dir():
        pytest.skip("needs libc6-arm64-cross")
    assert _difference(robot, run("aarch64-linux", QEMU), native) < AGREEMENT
