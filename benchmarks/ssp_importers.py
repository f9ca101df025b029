"""Torque-driven loops in other people's importers: how far the end effector is from where it is in our master, as a table.

    python benchmarks/ssp_importers.py

The paper's robot, 6 kg, with motor inertia 0.1 kg m2 and controllers at 4 kHz, as SSP files: largest difference in x within the
first 0.2 s, for communication steps of a sample time, half and a quarter of it. It needs what the tests need:
`pip install --group test`. A tool that isn't there is left out.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "ssp"))

from ssp_support.importers import SIGNAL, simulate

from flexfmu.cosim.ssp.export import export_ssp
from flexfmu.cosim.ssp.loading import load_ssp
from flexfmu.model.scene_file import load_scene

SAMPLE_TIME = 2.5e-4
STEPS = (SAMPLE_TIME, SAMPLE_TIME / 2, SAMPLE_TIME / 4)
INSTANTS = [n * 0.01 for n in range(1, 21)]
"""Where x is compared [s]."""

ROBOT = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "trajectory.dwell": 0.0}
PD = {"kind": "pd", "proportional": 10e3, "derivative": 100.0, "sample_time": SAMPLE_TIME}
PID = PD | {"kind": "pid", "integral": 300e3}
STAGGERED = {"offset": STEPS[-1]}


def encoder(window: int) -> dict[str, Any]:
    """An encoder of a million counts."""
    return {"kind": "encoder", "counts_per_turn": 1e6, "window": window, "sample_time": SAMPLE_TIME}


LOOPS: dict[str, dict[str, Any]] = {
    "PD": {"controller": [PD]},
    "PID": {"controller": [PID]},
    "PD, encoder, window 1": {"controller": [PD], "imperfection": [encoder(1)]},
    "PD, encoder, window 4": {"controller": [PD], "imperfection": [encoder(4)]},
    "PID, encoder": {"controller": [PID], "imperfection": [encoder(1)]},
    "PD, encoder, window 1, offset": {"controller": [PD | STAGGERED], "imperfection": [encoder(1)]},
    "PID, encoder, offset": {"controller": [PID | STAGGERED], "imperfection": [encoder(1)]},
}
"""What stands between motion and robot; with an offset the controller samples a quarter of a sample after the encoder."""


def differences(tool: str, path: Path) -> list[str]:
    """Largest difference to our master for each step [mm]; a run that ends early has none."""
    recording = load_ssp(path, stop=INSTANTS[-1]).simulate().recording
    exact = np.interp(INSTANTS, recording.time, recording[f"plant.{SIGNAL}"].values)
    cells = []
    for step in STEPS:
        try:
            cells.append(f"{1e3 * np.abs(simulate(tool, path, step, INSTANTS) - exact).max():.4f}")
        except Exception:  # each tool has its own
            cells.append("fails")
    return cells


def main() -> None:
    """Run and print."""
    print("largest difference to our master within 0.2 s [mm], end-effector position x")
    print(f"{'loop':32}{'importer':12}" + "".join(f"{1e3 * step:g} ms".ljust(12) for step in STEPS))
    with tempfile.TemporaryDirectory() as folder:
        for name, loop in LOOPS.items():
            path = export_ssp(load_scene("barnard2012-6kg").replace(ROBOT | loop), Path(folder) / "loop.ssp")
            for tool in ("libcosimpy", "ecospy", "fmpy"):
                try:
                    cells = differences(tool, path)
                except pytest.skip.Exception as missing:
                    cells = [f"left out: {missing}"]
                print(f"{name:32}{tool:12}" + "".join(cell.ljust(12) for cell in cells))


if __name__ == "__main__":
    main()
