"""Descriptions to check, and a run for other people's masters."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.extend(str(Path(__file__).parents[1] / "cosim" / "exchange" / each) for each in ("fmu_export", "ssp"))
sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder

from third_party_support.drawn import descriptions


@pytest.fixture(scope="session")
def described(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Model descriptions of the shipped scenes, of drawn ones and of blocks; name → modelDescription.xml."""
    home = tmp_path_factory.mktemp("descriptions")
    paths = {}
    for name, text in descriptions().items():
        folder = home / name
        folder.mkdir()
        paths[name] = folder / "modelDescription.xml"
        paths[name].write_text(text, encoding="utf-8")
    return paths
