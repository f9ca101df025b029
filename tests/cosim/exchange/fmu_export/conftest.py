"""Where exported FMUs are built, and how tests get at their instances."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder

from export_support.instance import opened

from flexfmu.fmu_build.block_build import build_block_fmu


@pytest.fixture(scope="session", autouse=True)
def export_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of all caches of this session; object files in it are shared by all tests."""
    return tmp_path_factory.mktemp("export")


@pytest.fixture(autouse=True)
def cache_folder(export_cache: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No test writes into the user's own cache."""
    monkeypatch.setenv("FLEXFMU_CACHE", str(export_cache))
    return export_cache


@pytest.fixture
def export(tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Function that exports a block and gives a function that makes instances of it."""
    with ExitStack() as stack:

        def make(block: Any, **options: Any) -> Any:
            return stack.enter_context(opened(build_block_fmu(block, **options).path, tmp_path))

        yield make
