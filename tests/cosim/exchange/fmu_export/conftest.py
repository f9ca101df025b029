"""How tests get at instances of exported FMUs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder

from export_support.instance import opened

from flexfmu.fmu_build.build import build_fmu


@pytest.fixture
def export(tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Function that exports a block and gives a function that makes instances of it."""
    with ExitStack() as stack:

        def make(block: Any, **options: Any) -> Any:
            return stack.enter_context(opened(build_fmu(block, **options).path, tmp_path))

        yield make
