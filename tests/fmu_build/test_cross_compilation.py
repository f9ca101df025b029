"""Binaries for other platforms, by zig."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from time import sleep

import pytest

from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.sources import generate_sources
from flexfmu.fmu_build.toolchain import PLATFORMS, find_compiler
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.symbolic import SymbolicModel

MakeModel = Callable[..., SymbolicModel]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs ziglang"),
]


@pytest.mark.parametrize("name", PLATFORMS)
def test_binaries_hold_no_time(make_oscillators: MakeModel, name: str) -> None:
    """Linked again a second later, the library has the same bytes, on every platform."""
    sources = generate_sources(make_oscillators(), DefaultExperiment())
    compiler = find_compiler(PLATFORMS[name])
    first = compile_library(sources, compiler)
    sleep(1.1)
    assert compile_library(sources, compiler) == first


def test_zig_builds_sound_fmus_too(make_oscillators: MakeModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a machine without a compiler the one from PyPI gives the same good FMU."""
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert validate_fmu(build_fmu(make_oscillators(), stop_time=0.1).path) == []
