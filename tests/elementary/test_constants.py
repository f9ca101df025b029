"""The tables and polynomials in C are what their generator gives."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_headers_are_generated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A number that nobody can derive again is a number that nobody can trust."""
    monkeypatch.syspath_prepend(str(ROOT / "generators"))
    from elementary_constants import headers

    kept = (ROOT / "fmu_build" / "c-runtime" / "math").glob("elementary_*_constants.h")
    assert {path.name: path.read_text() for path in kept} == headers()
