"""The lines of `speed.py` on metrics: their processor time in terms of the simulation's, with another payload each time. Not a script of its own."""

from __future__ import annotations

from collections.abc import Iterator
from time import process_time

import numpy as np
from paper_scene import SCENES
from speed_figure import SpeedFigure

from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.metrics.metrics import metrics_of

STEP, TOLERANCE = 1e-3, 1e-5

PAYLOADS = np.linspace(2.0, 8.0, 60)
"""Payloads [kg]; the first run of a scene isn't counted."""

PEAKS = [name for name in METRICS if name.startswith("peak_")]


def metric_figures() -> Iterator[SpeedFigure]:
    """All metrics of a run, and its peaks alone, in terms of the run."""
    for n, scene in SCENES.items():
        simulation, everything, peaks = costs(PreparedScene(scene, communication_step=STEP, tolerance=TOLERANCE))
        what = f"{n} degrees of freedom, {TOLERANCE:.0e}"
        for name, time, target in (("all metrics", everything, 1.0), ("peaks alone", peaks, 0.5)):
            note = f"{1e3 * time:.2f} of {1e3 * simulation:.2f} ms, another payload each time"
            yield SpeedFigure(f"{name} / simulation, {what}", time / simulation, target, "×", note=note)


def costs(prepared: PreparedScene) -> tuple[float, float, float]:
    """Least processor times [s] of a simulation, of all its metrics, and of the peaks alone of another simulation."""
    times = []
    for mass in PAYLOADS.tolist():
        first, run = timed_run(prepared, mass)
        before = process_time()
        metrics_of(run)
        everything = process_time() - before
        second, run = timed_run(prepared, mass + 1e-3)
        before = process_time()
        metrics_of(run, PEAKS)
        times.append((first, second, everything, process_time() - before))
    first, second, everything, peaks = np.min(times[1:], axis=0).tolist()
    return min(first, second), everything, peaks


def timed_run(prepared: PreparedScene, mass: float) -> tuple[float, Run]:
    """Processor time [s] of a simulation with this payload [kg], and the run."""
    before = process_time()
    run = prepared.run({"payload.mass": mass})
    return process_time() - before, run
