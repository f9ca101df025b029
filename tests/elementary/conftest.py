"""The elementary functions of the C runtime, as it is and under the sanitizers."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder

from elementary_support.probe import Evaluate, build_probe, results_of


@pytest.fixture(scope="session")
def evaluate(tmp_path_factory: pytest.TempPathFactory) -> Evaluate:
    """Function that gives the result of each call."""
    program = build_probe(tmp_path_factory.mktemp("plain"), ("-O2",))
    return lambda calls: results_of(program, calls)


@pytest.fixture(scope="session")
def evaluate_sanitized(tmp_path_factory: pytest.TempPathFactory) -> Evaluate:
    """The same under the address and undefined-behaviour sanitizers."""
    flags = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    program = build_probe(tmp_path_factory.mktemp("sanitized"), flags)
    return lambda calls: results_of(program, calls)
