"""Where the FMUs and programs of the tests at the FMI boundary are built."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
sys.path[:0] = [
    str(TESTS / "fmu_boundary"),
    str(TESTS / "cosim" / "exchange" / "fmu_export"),
]  # pytest imports tests without their folder


@pytest.fixture(scope="session", autouse=True)
def boundary_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of all FMUs of this session, which all tests share."""
    return tmp_path_factory.mktemp("boundary")


@pytest.fixture(autouse=True)
def cache_folder(boundary_cache: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No test writes into the user's own cache."""
    monkeypatch.setenv("FLEXFMU_CACHE", str(boundary_cache))
    return boundary_cache
