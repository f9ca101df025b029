"""What an installed package must bring along."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_runtime_and_templates_are_found_as_resources() -> None:
    """Building reads them through the package, wherever it is installed."""
    package = files("flexfmu.fmu_build")
    assert (package / "c-runtime" / "base" / "model.h").is_file()
    assert (package / "templates" / "modelDescription.xml.j2").is_file()


def test_fmus_carry_the_licence_of_the_project() -> None:
    """The licence inside an FMU is the project's own, word for word."""
    if not (ROOT / "LICENSE").is_file():
        pytest.skip("tests run away from the source tree")
    packed = files("flexfmu.fmu_build") / "templates" / "license.txt"
    assert packed.read_text(encoding="utf-8") == (ROOT / "LICENSE").read_text(encoding="utf-8")


def test_package_data_lists_every_file_that_building_needs() -> None:
    """An editable install hides missing package data; a wheel has only what the lists in pyproject.toml name."""
    project = ROOT / "pyproject.toml"
    if not project.is_file():
        pytest.skip("tests run away from the source tree")
    patterns = tomllib.loads(project.read_text(encoding="utf-8"))["tool"]["setuptools"]["package-data"]
    source = ROOT / "fmu_build"
    listed = {path for pattern in patterns["flexfmu.fmu_build"] for path in source.glob(pattern)}
    needed = {path for path in source.rglob("*") if path.suffix in {".c", ".h", ".j2", ".txt"}}
    assert needed
    assert needed <= listed
