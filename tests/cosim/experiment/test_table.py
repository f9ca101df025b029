"""The table of shapers, payload errors and drives comes out of its command."""

from __future__ import annotations

import csv
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SCRIPT = ROOT / "benchmarks" / "shapers_in_the_loop.py"


@pytest.mark.slow
def test_the_table(tmp_path: Path) -> None:
    """Every combination is there, with the figures of docs/shapers.md; a shaper takes vibration away with every drive, and a controller rests off the end pose
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
    assert_page_agrees(rows)


def assert_page_agrees(rows: Sequence[Mapping[str, str]]) -> None:
    """docs/shapers.md prints these residual vibrations, to its last digit but for rounding."""
    page = (ROOT / "docs" / "shapers.md").read_text(encoding="utf-8")
    for row in rows:
        title = f"### Residual vibration [µm], {row['drive']}, by payload error"
        table = page.split(title)[1].split("\n##")[0]
        line = next(line for line in table.splitlines() if line.startswith(f"| {row['shaper']} |"))
        column = {-0.3: 3, 0.0: 6, 0.3: 9}[round(float(row["payload_error"]), 6)]
        assert float(line.split("|")[column]) == pytest.approx(1e6 * float(row["residual_vibration"]), abs=0.06)
