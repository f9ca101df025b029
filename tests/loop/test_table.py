"""The table of shapers, payload errors and drives comes out of its command."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "shapers_in_the_loop.py"


@pytest.mark.slow
def test_the_table(tmp_path: Path) -> None:
    """Every combination is there; a shaper takes vibration away with every drive, and a controller rests off the end pose
    where the payload is wrong."""
    command = [sys.executable, str(SCRIPT), "--out", str(tmp_path), "--errors", "3", "--only", "unshaped", "zvd"]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert outcome.returncode == 0, outcome.stderr
    with (tmp_path / "shapers_in_the_loop.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 2 * 3
    assert "| zvd | 17.0 |" in (tmp_path / "shapers_in_the_loop.md").read_text(encoding="utf-8")
    found = {(row["drive"], row["shaper"], float(row["payload_error"])): row for row in rows}
    for drive in dict.fromkeys(row["drive"] for row in rows):
        for error in (-0.3, 0.0, 0.3):
            shaped, unshaped = (found[drive, shaper, error] for shaper in ("zvd", "unshaped"))
            assert float(shaped["residual_vibration"]) < float(unshaped["residual_vibration"])
            assert float(shaped["peak_torque"]) < float(unshaped["peak_torque"])
            if drive != "perfect drive":
                assert (float(shaped["rest_offset"]) > 1e-4) == (error != 0.0)
