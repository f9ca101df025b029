"""The lines of `speed.py` on sweeps: what storage and scheduling cost for each case, and how memory grows with their number. Not
a script of its own."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

from paper_scene import SCENES
from speed_figure import SpeedFigure

from flexfmu.cosim.many.variants import Variant, VariantTask
from flexfmu.cosim.studies.sweep.cases import Cases
from flexfmu.cosim.studies.sweep.sweep import sweep_scene
from flexfmu.cosim.studies.sweep.work import MOST_PEAKS

SCENE = SCENES[12]
PEAKS = ("peak_torque_1", "peak_torque_2")
FEW, MANY = 1000, 100_000
SINGLE = 5000
TARGET = 0.2
"""Milliseconds for each case."""


def sweep_figures() -> Iterator[SpeedFigure]:
    """Yield the figures of sweeps."""
    few, memory_of_few = _measured(FEW)
    many, memory_of_many = _measured(MANY)
    note = f"validation, scheduling and the journal; shares of up to {MOST_PEAKS}"
    yield SpeedFigure("sweep, overhead of a case side by side", 1e3 * many, TARGET, "ms", note=note)
    note = f"{SINGLE} cases, each sent to a process of its own and written at once"
    yield SpeedFigure("sweep, overhead of a case alone", 1e3 * overhead(SINGLE, alone=True), TARGET, "ms", note=note)
    note = f"from {FEW} to {MANY} cases, results as arrays included; {1e3 * few:.3f} ms for a case of the few"
    yield SpeedFigure(f"sweep, growth of memory, {MANY} cases", memory_of_many - memory_of_few, 50.0, "MB", note=note)


def _measured(count: int) -> tuple[float, float]:
    """The overhead [s] and the largest memory [MB] of a sweep in a process of its own."""
    command = f"import speed_sweep; speed_sweep.show({count})"
    folder = Path(__file__).parent
    found = subprocess.run([sys.executable, "-c", command], cwd=folder, check=True, capture_output=True, text=True)
    time, memory = map(float, found.stdout.split())
    return time, memory


def show(count: int) -> None:
    """Print what `_measured` reads."""
    print(overhead(count), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)


def overhead(count: int, *, alone: bool = False) -> float:
    """Processor time [s] of all processes for a case of a sweep in a folder that simulates nothing."""

    def outcomes(task: VariantTask[Any], variants: Sequence[Variant]) -> list[dict[str, float]]:
        return [dict.fromkeys(PEAKS, 1.0 / 3.0)] * len(variants)

    # other dwells are other motions, each simulated alone
    key, low, high = ("trajectory.dwell", 0.1, 0.3) if alone else ("payload.mass", 0.1, 8.0)
    cases = Cases((key,), [(low + (high - low) * i / count,) for i in range(count)])
    with tempfile.TemporaryDirectory() as folder, patch.object(VariantTask, "outcomes", outcomes):
        before = os.times()
        found = sweep_scene(SCENE, cases, metrics=PEAKS, processes=2, folder=Path(folder) / "out")
        spent = sum(os.times()[:4]) - sum(before[:4])
    assert not found.messages
    return spent / count
