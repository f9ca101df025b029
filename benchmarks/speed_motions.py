"""The measurements of `speed.py` on motions: many cycles, another duration, another payload. Not a script of its own."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Mapping, Sequence
from time import process_time

import numpy as np
from speed_figure import SpeedFigure

from flexfmu import load_scene
from flexfmu.cosim.engine.master.compiled_loop import CompiledLoop
from flexfmu.cosim.engine.master.grid import system_grid
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.cycles import repeated
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.experiment.timing import fastest
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.many.variants import run_variants

SCENE = load_scene("barnard2012-6kg")

ONE_SIGNAL = Selection(["joint1.torque"], order=0)

CYCLES, SOME_CYCLES = 1000, 100
"""Numbers of cycles, at 1 kHz and 1e-5: 1,372,000 and 137,200 communication steps."""

VARIANTS, ROUNDS = 100, 8
"""Number of variants, and rounds of which the fastest counts."""

Variants = Sequence[Mapping[str, float]]


def motion_figures() -> Iterator[SpeedFigure]:
    """Cycles, and what other motions and payloads cost beside the simulation."""
    ratio, note = cycles()
    yield SpeedFigure("1,000 cycles, first run, of 1,000 times one", ratio, 1.1, "×", note=note)
    growth = 1e-6 * (references(CYCLES) - references(SOME_CYCLES))
    yield SpeedFigure("memory for grid and references of 900 cycles more", growth, 2.0, "MB")
    duration, payload, steps = durations_and_payloads()
    note = f"simulation {1e3 * steps:.2f} ms"
    yield SpeedFigure("another duration, beside another payload", 1e3 * (duration - payload), 3.0, "ms", note=note)
    yield SpeedFigure("another payload, beside the simulation", 1e3 * payload, 1.0, "ms", note=note)


def cycles() -> tuple[float, str]:
    """Processor time of the first run of many cycles, divided by that of as many later runs of one; and both as a note."""
    scene = SCENE.replace({"cosimulation.step": 1e-3, "cosimulation.tolerance": 1e-5})
    one, many = (
        PreparedScene(scene, motion=repeated(plan(scene), number), record=ONE_SIGNAL) for number in (1, CYCLES)
    )
    # before and after, since the speed of a machine varies
    single = [fastest(one.run)]
    begin = process_time()
    many.run()
    whole = process_time() - begin
    single.append(fastest(one.run))
    mean = sum(single) / len(single)
    return whole / (CYCLES * mean), f"{whole:.1f} s; {1e3 * mean:.2f} ms for one"


def references(number: int) -> int:
    """Most memory [bytes] that communication points and references of so many cycles need at a time."""
    motion = repeated(plan(SCENE), number)
    tracemalloc.start()
    slave = TrajectorySlave(motion.joints)
    for block in system_grid(connect([slave], []), 0.0, motion.stop_time, 1e-3, ticks=True).blocks():
        slave.prepare(block.known)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


def durations_and_payloads() -> tuple[float, float, float]:
    """Processor time [s] beside the steps of a variant with another duration, and with another payload; that of the steps."""
    random = np.random.default_rng(1)
    found = []
    for _ in range(ROUNDS):
        durations = [{"trajectory.duration": duration} for duration in random.uniform(0.35, 0.6, VARIANTS).tolist()]
        payloads = [{"payload.mass": mass} for mass in np.linspace(0.0, 8.0, VARIANTS).tolist()]
        found.append((_beside(durations)[0], *_beside(payloads)))
    duration, payload, steps = (min(each) for each in zip(*found, strict=True))
    return duration, payload, steps


def _beside(variants: Variants) -> tuple[float, float]:
    """Processor time of a variant outside and inside of the loop over the communication points."""
    inside, go = [0.0], CompiledLoop.go

    def timed(loop: CompiledLoop, points: int) -> None:
        begin = process_time()
        go(loop, points)
        inside[0] += process_time() - begin

    CompiledLoop.go = timed  # type: ignore[method-assign]
    try:
        whole = _seconds(variants)
    finally:
        CompiledLoop.go = go  # type: ignore[method-assign]
    return (whole - inside[0]) / len(variants), inside[0] / len(variants)


def _seconds(variants: Variants) -> float:
    """Processor time of variants, with the peak torque of each."""
    scene = SCENE.replace({"cosimulation.step": 2e-3, "cosimulation.tolerance": 1e-3})
    begin = process_time()
    results = run_variants(scene, variants, _peak, record=Selection(["joint1.torque"]))
    taken = process_time() - begin
    if any(each.error is not None for each in results):
        raise RuntimeError("a variant failed")
    return taken


def _peak(run: Run) -> float:
    return float(abs(run.recording["joint1.torque"].values).max())


if __name__ == "__main__":
    for figure in motion_figures():
        print(figure.line(), flush=True)
