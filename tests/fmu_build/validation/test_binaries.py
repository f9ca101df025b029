"""The checks of an FMU's Linux libraries."""

from __future__ import annotations

import random
import sys
from pathlib import Path
from types import SimpleNamespace

import casadi
import pytest

from flexfmu.fmu_build.validation.binaries import check_binaries
from flexfmu.fmu_build.validation.finding import Finding

LIBRARY = "binaries/linux64/model.so"


def _findings(library: bytes) -> list[Finding]:
    """Findings about the only library of an FMU for co-simulation."""
    description = SimpleNamespace(
        fmiMajorVersion=2, coSimulation=SimpleNamespace(modelIdentifier="model"), modelExchange=None
    )
    return [finding for finding in check_binaries(description, {LIBRARY: library}) if LIBRARY in finding.message]


@pytest.fixture(scope="module")
def casadi_library() -> bytes:
    """A library for numbers that is no FMU: CasADi's interface to a solver."""
    return min(Path(casadi.__file__).parent.glob("libcasadi_*.so*"), key=lambda path: path.stat().st_size).read_bytes()


@pytest.mark.skipif(sys.platform != "linux", reason="ELF is Linux's format")
def test_finds_what_a_library_exports_and_needs(casadi_library: bytes) -> None:
    """CasADi's library has none of the FMI functions, exports C++ functions and not what it imports, and needs CasADi."""
    missing, foreign, needed, *_ = [finding.message for finding in _findings(casadi_library)]
    assert "does not export fmi2CancelStep" in missing
    assert "casadi" in foreign
    assert "malloc" not in foreign
    assert "libcasadi.so" in needed


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a 64-bit ELF file"),
        (b"MZ", "not a 64-bit ELF file"),
        (b"\x7fELF\x02\x01", "damaged ELF file"),
        (b"\x7fELF\x02\x01" + b"\xff" * 100, "damaged ELF file"),
    ],
)
def test_other_or_damaged_files_are_findings(content: bytes, message: str) -> None:
    """A Windows library under a Linux name is a finding, not a crash."""
    assert [finding.message for finding in _findings(content)] == [f"{LIBRARY}: {message}"]


@pytest.mark.skipif(sys.platform != "linux", reason="ELF is Linux's format")
def test_random_damage_is_a_finding_too(casadi_library: bytes) -> None:
    """Whatever stands in the headers, the check ends, and without an exception; a library that is cut off is damaged."""
    rng = random.Random(7)
    for _ in range(100):
        damaged = bytearray(casadi_library)
        headers = int.from_bytes(damaged[40:48], "little")
        for place in [rng.randrange(64), *(rng.randrange(headers, len(damaged)) for _ in range(5))]:
            damaged[place] = rng.randrange(256)
        assert _findings(bytes(damaged))
        cut = casadi_library[: rng.randrange(6, headers)]
        assert [finding.message for finding in _findings(cut)] == [f"{LIBRARY}: damaged ELF file"]
