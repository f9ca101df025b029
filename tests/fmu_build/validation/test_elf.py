"""The reader of exported symbols."""

from __future__ import annotations

import sys
from pathlib import Path

import casadi
import pytest

from flexfmu.fmu_build.validation.elf import NotElfError, exported_symbols


@pytest.mark.skipif(sys.platform != "linux", reason="ELF is Linux's format")
def test_reads_a_library_that_is_there() -> None:
    """CasADi's own library exports C++ functions, and does not export what it imports."""
    folder = Path(casadi.__file__).parent
    library = next(folder.glob("libcasadi.so*")).read_bytes()
    symbols = exported_symbols(library)
    assert any("casadi" in symbol for symbol in symbols)
    assert "malloc" not in symbols


@pytest.mark.parametrize("content", [b"", b"MZ", b"\x7fELF\x02\x01", b"\x7fELF\x02\x01" + b"\xff" * 100])
def test_other_or_damaged_files_are_refused(content: bytes) -> None:
    """A Windows library under a Linux name is a finding, not a crash."""
    with pytest.raises(NotElfError):
        exported_symbols(content)
