"""Validation of FMUs that other tools have made."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import pytest
from third_party_support.tools import python_tool, run

from flexfmu.fmu_build.toolchain import native_platform
from flexfmu.fmu_build.validation.finding import Severity
from flexfmu.fmu_build.validation.validate import validate_fmu

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(native_platform().name != "linux64", reason="says what this binary does on Linux"),
]

DECAY = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Decay(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.x = 1.0
        self.u = 0.0
        self.register_variable(Real("u", causality=Fmi2Causality.input, start=0.0))
        self.register_variable(Real("x", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.x += step_size * (self.u - self.x)
        return True
"""


@pytest.fixture(scope="module")
def decay(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU that PythonFMU makes."""
    python_tool("pythonfmu")
    folder = tmp_path_factory.mktemp("pythonfmu")
    (folder / "decay.py").write_text(DECAY)
    run([sys.executable, "-m", "pythonfmu", "build", "-f", "decay.py", "--dest", "."], folder)
    return folder / "Decay.fmu"


def test_faults_of_a_foreign_fmu_are_found(decay: Path) -> None:
    """It takes any GUID and crashes on a short URI; validation survives that, and finds the missing initial unknowns."""
    found = {finding.check for finding in validate_fmu(decay)}
    assert {"model description", "binary", "dependencies", "guid", "resource location"} <= found
    assert "simulation" not in found


def test_fmu_without_a_binary_for_this_machine_is_checked_statically(decay: Path, tmp_path: Path) -> None:
    """An FMU for Windows alone is no broken FMU."""
    windows = tmp_path / "windows.fmu"
    with zipfile.ZipFile(decay) as source, zipfile.ZipFile(windows, "w") as target:
        for name in source.namelist():
            if not name.startswith("binaries/linux64/"):
                target.writestr(name, source.read(name))
    binary = [finding for finding in validate_fmu(windows) if finding.check == "binary"]
    assert [finding.severity for finding in binary] == [Severity.WARNING]
    assert "the FMU has win64" in binary[0].message
