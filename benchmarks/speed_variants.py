"""The lines of `speed.py` on variants in lockstep: the time of 100,000 payloads, from a fiftieth of them. Not a script of its own."""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Iterator

import numpy as np
from paper_scene import SCENES
from speed_figure import SpeedFigure

from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.many.variants import SideBySide, run_variants
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.metrics.metrics import measuring
from flexfmu.fmu_build.batch_build import lanes_of_processor

SCENE = SCENES[12]
COUNT, ALL = 2000, 100_000
STEP, TOLERANCE = 1e-3, 1e-5
PROCESSES = 2
PEAKS = ("peak_torque_1", "peak_torque_2")
TORQUES = ("joint1.torque", "joint2.torque")


def lockstep_figures() -> Iterator[SpeedFigure]:
    """Yield the figures of variants in lockstep."""
    note = f"{COUNT} times {ALL // COUNT}, {STEP:g} s, {TOLERANCE:g}"
    for what, names, target in (("peak torques", PEAKS, 60.0), ("all metrics", METRICS, 300.0)):
        name = f"{ALL} variants, {what}, {PROCESSES} processes"
        yield SpeedFigure(name, whole(names), target, "s", note=note)
    for lanes in (4, 8):
        if lanes <= lanes_of_processor():
            name = f"{ALL} variants, peak torques, {lanes} lanes, {PROCESSES} cores"
            yield SpeedFigure(name, solver(lanes) / PROCESSES, 60.0, "s", note="processor time / 2")


def changes() -> list[dict[str, float]]:
    """The variants: payloads [kg]."""
    return [{"payload.mass": float(mass)} for mass in np.linspace(0.1, 8.0, COUNT)]


def whole(names: Collection[str]) -> float:
    """Processor time [s] of all variants with several processes, divided by their number."""
    variants, measure = changes(), measuring(names)
    options = {"communication_step": STEP, "tolerance": TOLERANCE}
    run_variants(SCENE, variants[:16], measure, **options)  # compiles
    before = os.times()
    found = run_variants(SCENE, variants, measure, processes=PROCESSES, **options)
    assert all(each.error is None for each in found)
    return (sum(os.times()[:4]) - sum(before[:4])) / PROCESSES * ALL / COUNT


def solver(lanes: int) -> float:
    """Processor time [s] of all variants in one process."""
    side_by_side = SideBySide(SCENE, build_scene(SCENE).path, STEP, TOLERANCE, lanes)
    side_by_side.peaks(changes()[:lanes], TORQUES)  # compiles
    started = time.process_time()
    found = side_by_side.peaks(changes(), TORQUES)
    assert None not in found
    return (time.process_time() - started) * ALL / COUNT
