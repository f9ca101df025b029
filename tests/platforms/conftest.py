"""One small robot, compiled for every platform that the C compilers at hand can serve."""

from __future__ import annotations

import importlib.util
import os
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.fmu_build.sources import Sources
from flexfmu.fmu_build.toolchain import PLATFORMS, find_compiler, fmi_header_folder, native_platform
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicModel

LibraryFor = Callable[..., bytes]
Array = NDArray[np.float64]

STEPS, STEP = 100, 2e-3


@pytest.fixture
def zig() -> None:
    """Skips the test where there is no zig."""
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("needs ziglang")


@pytest.fixture(scope="session")
def robot() -> SymbolicModel:
    """The paper's robot with one mode per link, so that it compiles quickly."""
    scene = load_scene("barnard2012-6kg")
    return build_model(scene.replace({"effects.proximal_bending": 1, "effects.distal_axial": 1}))


@pytest.fixture(scope="session")
def robot_sources(robot: SymbolicModel) -> Sources:
    """Its FMU before compilation."""
    return generate_sources(robot, DefaultExperiment())


@pytest.fixture(scope="session")
def library_for(robot_sources: Sources) -> LibraryFor:
    """Function that compiles it for a platform, each once; with zig even where the machine has another compiler."""

    @cache
    def compile_once(name: str, with_zig: bool = False) -> bytes:
        with pytest.MonkeyPatch.context() as patch:
            if with_zig:
                patch.setenv("PATH", "")
                patch.delenv("CC", raising=False)
            return compile_library(robot_sources, find_compiler(PLATFORMS[name]))

    return compile_once


@pytest.fixture
def run(tmp_path: Path, robot: SymbolicModel, robot_sources: Sources, library_for: LibraryFor) -> Callable[..., Array]:
    """Function that runs the robot's library of a platform, or a given one, in a C program: its outputs, shape (steps, outputs)."""

    def run_on(
        name: str, emulator: tuple[str, ...] = (), *, with_zig: bool = False, library: Path | None = None
    ) -> Array:
        if library is None:
            library = tmp_path / f"{robot_sources.model_identifier}{PLATFORMS[name].suffix}"
            library.write_bytes(library_for(name, with_zig))
        # the same flags as the libraries, so that zig builds its parts of the C library once; the mathematics library comes
        # along as with every importer that computes: fmpy's own compilation doesn't link it
        program = tmp_path / f"harness-{name}{'.exe' if name == 'win64' else ''}"
        linked = ["-ldl", "-Wl,--no-as-needed", "-lm"] if "linux" in name else []
        flags = ["-std=c99", "-O2", "-ffp-contract=off", "-s", "-Wl,--gc-sections", "-I", fmi_header_folder()]
        command = [*find_compiler(PLATFORMS[name]).command, *flags, Path(__file__).with_name("harness.c")]
        subprocess.run([*command, "-o", program, *linked], check=True, capture_output=True)
        first = len(robot.inputs) + len(robot.parameters)
        numbers = (len(robot.outputs), first, STEPS, STEP)
        outcome = subprocess.run(
            [*emulator, program, library.name, robot_sources.guid, *map(str, numbers)],
            cwd=tmp_path,
            env=os.environ | {"WINEDEBUG": "-all", "LD_LIBRARY_PATH": str(library.parent)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert outcome.returncode == 0, outcome.stderr
        return np.array([[float.fromhex(word) for word in line.split()] for line in outcome.stdout.splitlines()])

    return run_on


@pytest.fixture
def native(run: Callable[..., Array]) -> Array:
    """Outputs of this machine's own binary."""
    if native_platform().zig_target != PLATFORMS["linux64"].zig_target:
        pytest.skip(f"the reference is linux64, this is {native_platform().zig_target}")
    outputs = run("linux64")
    assert np.ptp(outputs, axis=0).min() > 0.0, "every output should move"
    return outputs
