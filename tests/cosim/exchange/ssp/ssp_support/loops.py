"""Torque-driven loops of the paper's robot at 4 kHz, in our master and in other people's importers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.exchange.ssp.export import export_ssp
from flexfmu.cosim.exchange.ssp.loading import load_ssp
from flexfmu.model.scene.file import load_scene
from ssp_support.importers import SIGNAL, simulate

Table = NDArray[np.float64]

SAMPLE_TIME = 2.5e-4
STEPS = (SAMPLE_TIME, SAMPLE_TIME / 2, SAMPLE_TIME / 4)
INSTANTS = [n * 0.01 for n in range(1, 21)]
"""Where positions are compared [s]."""

ROBOT = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "trajectory.dwell": 0.0}
PD = {"kind": "pd", "proportional": 10e3, "derivative": 100.0, "sample_time": SAMPLE_TIME}
PID = PD | {"kind": "pid", "integral": 300e3}
KILOHERTZ = {"sample_time": 1e-3}
SLOW = PD | {"proportional": 5e3, "derivative": 50.0} | KILOHERTZ
SAMPLE_OF_DELAY = [{"kind": "delay", "signal": each, "time": 1e-3} | KILOHERTZ for each in ("position", "velocity")]
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
    "PD at 1 kHz, encoder": {"controller": [SLOW], "imperfection": [encoder(1) | KILOHERTZ]},
    "PD at 1 kHz, encoder, offset": {"controller": [SLOW | STAGGERED], "imperfection": [encoder(1) | KILOHERTZ]},
    "PD at 1 kHz, encoder, delay": {"controller": [SLOW], "imperfection": [encoder(1) | KILOHERTZ, *SAMPLE_OF_DELAY]},
}
"""What stands between motion and robot; with an offset the controller samples a quarter of a sample after the encoder."""


def export_loop(name: str, folder: Path) -> Path:
    """The SSP file of a loop."""
    return export_ssp(load_scene("barnard2012-6kg").replace(ROBOT | LOOPS[name]), folder / "loop.ssp")


def in_our_master(path: Path) -> Table:
    """Positions at the instants [m], by our master.

    Raises:
        RuntimeError: it doesn't get there, with its message.
    """
    simulation = load_ssp(path, stop=INSTANTS[-1]).simulate()
    if simulation.outcome is not Outcome.COMPLETED:
        raise RuntimeError(simulation.message)
    recording = simulation.recording
    return np.interp(INSTANTS, recording.time, recording[f"plant.{SIGNAL}"].values)


def off(tool: str, path: Path, step: float, exact: Table) -> Table:
    """Differences of an importer's positions to exact ones [m]."""
    return np.abs(simulate(tool, path, step, INSTANTS) - exact)
