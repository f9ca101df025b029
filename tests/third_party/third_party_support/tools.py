"""Where other people's tools are: `.ci/tools` puts jars into build/tools, the rest comes from PyPI and Debian."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[3]
FOLDER = Path(os.environ.get("FLEXFMU_TOOLS", ROOT / "build" / "tools"))
"""Folder of the jars."""


def class_path(name: str) -> str:
    """Java class path of a tool; skips the test where Java or the jars are missing."""
    if shutil.which("java") is None:
        pytest.skip(f"{name} needs Java")
    if not (FOLDER / name / ".complete").exists():
        pytest.skip(f"{name} is not in {FOLDER}; .ci/tools fetches it")
    return f"{FOLDER / name}/*"


def python_tool(name: str) -> ModuleType:
    """A Python package that may be missing, or a library that it needs; skips the test then."""
    try:
        return importlib.import_module(name)
    except (ImportError, OSError) as error:
        pytest.skip(f"{name} is not there: {error}")


def run(command: Sequence[str], folder: Path, timeout: float = 600.0) -> str:
    """Output of a tool that has to succeed."""
    outcome = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=timeout, check=False)
    assert outcome.returncode == 0, f"{command[0]} ended with {outcome.returncode}: {outcome.stdout}\n{outcome.stderr}"
    return outcome.stdout
