"""Checks by other people's tools don't vanish in a green run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = """
import pytest

def test_of_a_tool():
    pytest.skip("needs wine")

def test_of_another_system():
    pytest.skip("reads ELF")

@pytest.mark.xfail(strict=True)
def test_that_fails_as_expected():
    assert False

def test_that_passes(): ...
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("required", "summary", "status"),
    [("1", "1 failed, 1 passed, 1 skipped, 1 xfailed, 1 error", 1), ("0", "1 passed, 3 skipped, 1 xfailed", 0)],
)
def test_a_missing_tool(required: str, summary: str, status: int, tmp_path: Path) -> None:
    """Where tools are required a test or a file that misses one fails, and nothing else does; in any case it is named."""
    shutil.copy(Path(__file__).parents[1] / "conftest.py", tmp_path)
    (tmp_path / "test_tool.py").write_text(TESTS)
    (tmp_path / "test_file.py").write_text('import pytest\npytest.importorskip("no_such_package")\n')
    options = ["-q", "-rsfE", "-p", "no:cacheprovider", "--continue-on-collection-errors"]
    environment = {**os.environ, "FLEXFMU_REQUIRE_TOOLS": required}
    command = [sys.executable, "-m", "pytest", *options]
    outcome = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600)
    assert outcome.returncode == status, outcome.stdout
    assert summary in outcome.stdout
    assert all(name in outcome.stdout for name in ("needs wine", "reads ELF", "no_such_package"))
