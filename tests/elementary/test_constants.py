"""The tables and polynomials in C are what their generator gives."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def headers() -> dict[str, str]:
    """Generated anew."""
    sys.path.insert(0, str(ROOT / "generators"))
    from elementary_constants import headers

    return headers()


@pytest.mark.slow
def test_headers_are_generated(headers: dict[str, str]) -> None:
    """A number that nobody can derive again is a number that nobody can trust."""
    kept = {
        path.name: path.read_text()
        for path in (ROOT / "fmu_build" / "c-runtime" / "math").glob("elementary_*_constants.h")
    }
    assert kept == headers
