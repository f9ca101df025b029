"""Validation finds nothing in what this package builds; what it finds in others' FMUs is in `test_validate_mutants.py`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.symbolic import SymbolicModel

MakeModel = Callable[..., SymbolicModel]


@pytest.mark.slow
@pytest.mark.parametrize("model", ["make_oscillators", "make_lever"])
def test_sound_fmu_has_no_findings(
    model: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What this package builds passes its own checks and fmpy's, also where it is named as users do, from its folder."""
    make: MakeModel = request.getfixturevalue(model)
    build_fmu(make(), stop_time=0.1, output=tmp_path / "sound.fmu")
    monkeypatch.chdir(tmp_path)
    assert validate_fmu(Path("sound.fmu")) == []


def test_missing_file_is_an_error(tmp_path: Path) -> None:
    """A wrong path says how to get an FMU."""
    with pytest.raises(ArchiveError, match="flexfmu build"):
        validate_fmu(tmp_path / "none.fmu")
