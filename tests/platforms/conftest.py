"""One small robot, compiled for every platform that the C compilers at hand can serve."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.platforms import PLATFORMS
from flexfmu.fmu_build.sources import Sources, generate_sources
from flexfmu.fmu_build.toolchain import find_compiler
from flexfmu.model.plants import build_model
from flexfmu.model.scene_file import load_scene
from flexfmu.model.symbolic import SymbolicModel

LibraryFor = Callable[..., bytes]


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
def library_for(robot_sources: Sources, tmp_path_factory: pytest.TempPathFactory) -> LibraryFor:
    """Function that compiles it for a platform, each once; with zig even where the machine has another compiler."""
    folder = tmp_path_factory.mktemp("platforms")

    @cache
    def compile_once(name: str, with_zig: bool = False) -> bytes:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("FLEXFMU_CACHE", str(folder))
            if with_zig:
                patch.setenv("PATH", "")
                patch.delenv("CC", raising=False)
            return compile_library(robot_sources, find_compiler(PLATFORMS[name]))

    return compile_once


@pytest.fixture
def write_library(tmp_path: Path, library_for: LibraryFor, robot_sources: Sources) -> Callable[..., Path]:
    """Function that writes a platform's library into a file of its proper name."""

    def write(name: str, with_zig: bool = False) -> Path:
        path = tmp_path / f"{robot_sources.model_identifier}{PLATFORMS[name].suffix}"
        path.write_bytes(library_for(name, with_zig))
        return path

    return write
