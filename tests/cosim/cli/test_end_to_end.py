"""From a scene file to results with a real FMU in the middle, by the command alone."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from fmpy.util import read_csv

from flexfmu.cosim.metrics.metric_table import COMMON_METRICS

FLEXFMU = (sys.executable, "-c", "from flexfmu.cosim.cli.main import main; main()")


def flexfmu(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command in ``folder`` and wait for it."""
    return subprocess.run([*FLEXFMU, *arguments], capture_output=True, text=True, timeout=600, check=False, cwd=folder)


def small_scene(folder: Path, **replacements: str) -> Path:
    """One bending mode and nothing else: an FMU that compiles in a moment."""
    text = files("flexfmu.model.scene").joinpath("scenes", "barnard2012-6kg.toml").read_text(encoding="utf-8")
    changes = {
        'name = "barnard2012-6kg"': 'name = "small"',
        "proximal_bending = 3": "proximal_bending = 1",
        "distal_axial = 3": "distal_axial = 0",
    }
    for old, new in (changes | replacements).items():
        assert old in text
        text = text.replace(old, new)
    path = folder / "small.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
def test_scene_to_results(tmp_path: Path) -> None:
    """build, validate and run: an FMU without findings, a CSV that fmpy reads, metrics of a flexible robot."""
    scene = small_scene(tmp_path)
    built = flexfmu(tmp_path, "build", str(scene), "--json")
    assert (built.returncode, built.stderr) == (0, "")
    fmu = json.loads(built.stdout)["path"]
    assert flexfmu(tmp_path, "validate", fmu).stdout == f"{fmu}: no findings\n"

    run = flexfmu(tmp_path, "run", str(scene), "--json")
    assert (run.returncode, run.stderr) == (0, "")
    summary = json.loads(run.stdout)
    folder = tmp_path / "results" / "small"
    assert summary == json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert list(summary["metrics"]) == list(COMMON_METRICS)
    assert all(value is None or math.isfinite(value) for value in summary["metrics"].values())
    assert 60.0 < summary["metrics"]["peak_torque_1"] < 90.0
    assert summary["versions"]["compiler"]
    results = read_csv(folder / "results.csv")
    assert results.dtype.names[0] == "time"
    assert np.all(np.diff(results["time"]) >= 0.0)
    assert results["time"][-1] == pytest.approx(0.68)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX does")
def test_interrupt_is_one_line(tmp_path: Path) -> None:
    """Ctrl-C at any moment: one line and status 1."""
    scene = small_scene(tmp_path, **{"step = 2e-4": "step = 1e-6"})
    assert flexfmu(tmp_path, "build", str(scene)).returncode == 0
    process = subprocess.Popen(
        [*FLEXFMU, "run", str(scene)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    )
    while process.poll() is None and not (tmp_path / "results" / "small").is_dir():
        time.sleep(0.02)
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=600)
    assert (process.returncode, errors.count("\n")) == (1, 1), errors
    assert "interrupted" in errors
