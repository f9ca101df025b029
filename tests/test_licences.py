"""The list of licences: every package that flexfmu needs, each with what its metadata states."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_every_dependency_is_listed_with_its_licence() -> None:
    """Those of dependencies too; a licence is a few words, never a whole text."""
    script = Path(__file__).parents[1] / "generators" / "licences.py"
    listed = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True).stdout
    licences = {name: licence for name, _, licence in (line.split(maxsplit=2) for line in listed.splitlines())}
    assert {"flexfmu", "numpy", "scipy", "casadi", "fmpy", "lxml", "uPlot"} <= {*licences}
    assert "BSD" in licences["numpy"]
    assert "Lesser General" in licences["casadi"]
    assert {name for name, licence in licences.items() if licence == "not stated"} <= {"fmpy"}
    assert max(map(len, licences.values())) < 200
