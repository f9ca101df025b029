"""What the master costs per communication step: the paper's scene through its FMU, and the same with an idle plant instead.

The idle plant has the FMU's variables and does nothing, so what remains is the master, the trajectory and the recording. The
difference is the FMU itself: its integrator, its outputs with two derivatives, and the calls through ctypes. Processor times, the
best of several runs.

    python benchmarks/overhead.py [--repeat 7] [--json]
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass

import numpy as np
from paper_scene import SCENE, best_times, timed_run

from flexfmu.cosim.fmu_slave import FmuSlave
from flexfmu.cosim.grid import time_grid
from flexfmu.cosim.planning import plan
from flexfmu.cosim.slave import Call, Indices, RealArray
from flexfmu.fmu_build.scene_build import build_scene

STEPS = (5e-5, 2e-4, 1e-3, 5e-3)


class IdlePlant:
    """A slave with the variables of another one that does nothing."""

    def __init__(self, like: FmuSlave) -> None:
        self.name, self.variables, self.feedthrough = like.name, like.variables, like.feedthrough
        self.max_input_order, self.max_output_order = like.max_input_order, like.max_output_order

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None: ...
    def step(self, time: float, step: float) -> None: ...
    def set(self, indices: Indices, values: RealArray) -> None: ...
    def get(self, indices: Indices, values: RealArray) -> None: ...
    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None: ...
    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None: ...

    def bind_set(self, indices: Indices, values: RealArray) -> Call:
        return do_nothing

    def bind_get(self, indices: Indices, values: RealArray) -> Call:
        values[:] = 0.0
        return do_nothing

    def bind_set_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        return do_nothing

    def bind_get_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        derivatives[:] = 0.0
        return do_nothing


def do_nothing() -> None:
    """A call that transfers nothing."""


@dataclass(frozen=True)
class Row:
    """One line of the table: processor times of a run [s]."""

    communication_step: float
    steps: int
    with_fmu: float
    with_idle_plant: float


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="What the master costs per communication step.")
    parser.add_argument("--repeat", type=int, default=7, help="runs of which the fastest counts")
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    options = parser.parse_args()
    plant = FmuSlave(build_scene(SCENE).path, "plant")
    rows = measure(plant, options.repeat)
    if options.json:
        print(json.dumps([asdict(row) for row in rows], indent=2))
        return
    print("    step    steps   whole run   idle plant   difference")
    for row in rows:
        run, idle = 1e3 * row.with_fmu, 1e3 * row.with_idle_plant
        print(
            f"{1e3 * row.communication_step:5.2f} ms {row.steps:8d} {run:8.1f} ms {idle:9.1f} ms {run - idle:9.1f} ms"
        )
    per_step, fixed = np.polyfit([row.steps for row in rows], [row.with_idle_plant for row in rows], 1)
    print(
        f"master, trajectory and recording: {1e3 * fixed:.0f} ms per run + {1e6 * per_step:.1f} µs per communication step"
    )


def measure(plant: FmuSlave, repeat: int) -> list[Row]:
    """Both runs at all communication steps, the best of several rounds."""
    tolerance, plants, motion = SCENE.cosimulation.tolerance, (plant, IdlePlant(plant)), plan(SCENE)
    times = best_times([timed_run(each, step, tolerance) for each in plants for step in STEPS], repeat)
    counts = [time_grid(0.0, motion.stop_time, step, motion.joints.breakpoints).times.size - 1 for step in STEPS]
    return [Row(*row) for row in zip(STEPS, counts, times[: len(STEPS)], times[len(STEPS) :], strict=True)]


if __name__ == "__main__":
    main()
