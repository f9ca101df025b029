"""The measurements of `speed.py`: processor times of whole runs, of the master alone, of many variants, and of other tools. Not a script of its own."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import exudyn_time
import fmu_cost
import numpy as np
from idle import IdlePlant, idle_fmu
from paper_scene import SCENE, SCENES, Timed, best_times, run_with, timed, whole_run

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the comparison with other formulations

from formulations import SHAPES

from flexfmu.benchmarks.peers.exudyn_trials import comparable
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.experiment.timing import fastest
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.many.variants import run_variants
from flexfmu.cosim.metrics.segments import Analysis
from flexfmu.cosim.metrics.signals import segments
from flexfmu.cosim.studies.workprec.solver_trials import scipy_run, system_of
from flexfmu.cosim.studies.workprec.trial import completed, subject_of
from flexfmu.fmu_build.toolchain import find_compiler, native_platform

STEP = 1e-3
"""Communication step of all runs [s]: recording at 1 kHz."""

TOLERANCES = (1e-3, 1e-5)

RECORDINGS = {"values": (Selection(None, order=0), "with_outputs"), "2 derivatives": (Selection(None), "whole")}
"""Recorded part of all outputs → its selection, and the name of the FMU's part of it in `fmu_cost.c`."""

SHORT_STEP = 1e-4
"""The master's cost of a step is what runs with this step take longer than those with `STEP`, for each step more [s]."""

PAYLOADS = np.linspace(0.0, 8.0, 100)
DURATIONS = np.linspace(0.35, 0.6, 10)
"""The variants: 1,000 in all [kg, s]."""

VARIANT_STEP = 2e-3
"""Communication step of the variants [s]: with two derivatives of the torque its peak between the instants is known to 1e-4,
which values alone at 1 ms miss by up to 2e-3."""

RADAU_TOLERANCES = (1e-4, 1e-5, 1e-6)


@dataclass(frozen=True)
class Whole:
    """One scene at one tolerance, recorded in one way: processor times [s] and the FMU's counters.

    Attributes:
        time: from the first step to the complete recording.
        integration: of the FMU's integrator alone, called from C.
        inside: of all calls of the FMU, made from C.
        floor: of the calls of generated functions among these.
        counters: steps, evaluations and so on.
    """

    time: float
    integration: float
    inside: float
    floor: float
    counters: Mapping[str, int]


def whole_runs(folder: Path, repeat: int) -> dict[tuple[int, float, str], Whole]:
    """(degrees of freedom, tolerance, what is recorded) → what it costs; times of all of them in turn."""
    cases, inner_cases = list(itertools.product(SCENES, TOLERANCES, RECORDINGS)), itertools.product(SCENES, TOLERANCES)
    inner_costs = {n: InnerCost(n, folder) for n in SCENES}
    runs = [whole_run(SCENES[n], STEP, tolerance, record=RECORDINGS[what][0]) for n, tolerance, what in cases]
    inner: dict[tuple[int, float], dict[str, float]] = {case: {} for case in inner_cases}
    best = [np.inf] * len(cases)
    for _ in range(3):
        best = np.minimum(best, best_times(runs, max(1, repeat // 3))).tolist()
        for (n, tolerance), least in inner.items():
            found = inner_costs[n].run(tolerance, max(1, repeat // 3))
            least |= {name: min(value, least.get(name, value)) for name, value in found.items()}
    return {
        (n, tolerance, what): _whole(inner_costs[n].steps, time, inner[n, tolerance], RECORDINGS[what][1])
        for (n, tolerance, what), time in zip(cases, best, strict=True)
    }


def _whole(steps: int, time: float, found: Mapping[str, float], depth: str) -> Whole:
    floor = fmu_cost.floors(found, steps)[f"{depth}_floor"]
    return Whole(
        time, found["integration"], found[depth], floor, {name: int(found[name]) for name in fmu_cost.COUNTERS}
    )


class InnerCost:
    """The FMU's sources with `fmu_cost.c`, and the motion that it plays."""

    def __init__(self, coordinates: int, folder: Path) -> None:
        self._table = folder / f"inputs{coordinates}.bin"
        self.steps = fmu_cost.write_inputs(SCENES[coordinates], STEP, self._table)
        self._library = fmu_cost.build(SCENES[coordinates], folder)

    def run(self, tolerance: float, repeat: int) -> dict[str, float]:
        """Its figures for the integrator that is chosen by default."""
        return fmu_cost.run(self._library, self._table, "automatic", tolerance, repeat)


def overheads(folder: Path, repeat: int, record: Selection = EVERYTHING) -> dict[str, float]:
    """The master's time [s] for each communication step, trajectory and recording included, by what the plant is."""
    real = build_scene(SCENE).path
    idle = idle_fmu(real, folder)
    plants = {"compiled": FmuSlave(idle, "plant"), "python": IdlePlant(FmuSlave(real, "plant"))}
    runs: list[Timed] = [run_with(plant, step, record) for plant in plants.values() for step in (STEP, SHORT_STEP)]
    times = np.reshape(best_times(runs, repeat), (-1, 2))
    stop = PreparedScene(SCENE, fmu_path=real).stop_time
    more = stop / SHORT_STEP - stop / STEP
    return {name: float(short - long) / more for name, (long, short) in zip(plants, times, strict=True)}


def peak_torque(run: Run) -> float:
    """The metric of each variant [N.m]."""
    return Analysis(segments(run.recording, ["joint1.torque"])).peak()[0]


def cold_build() -> float:
    """Processor time [s] of a build without cache, the compiler's included."""
    before = os.times()
    build_scene(SCENE, cache=False)
    return sum(os.times()[:4]) - sum(before[:4])


def variants() -> float:
    """Processor time [s] of 1,000 variants, payloads times motions, with the peak torque of each, FMU and plans included."""
    changes = [
        {"payload.mass": float(mass), "trajectory.duration": float(duration)}
        for mass, duration in itertools.product(PAYLOADS, DURATIONS)
    ]

    def all_of_them() -> None:
        found = run_variants(
            SCENE,
            changes,
            peak_torque,
            communication_step=VARIANT_STEP,
            tolerance=1e-3,
            record=Selection(["joint1.torque"]),
        )
        for each in found:
            if each.error is not None:
                raise each.error

    return timed(all_of_them)()


@dataclass(frozen=True)
class Reached:
    """A run of another tool: processor time [s], and its error, relative to the largest elastic deviation."""

    time: float
    error: float


class Peers:
    """The same motion by other tools, with errors in positions at multiples of 1 ms."""

    def __init__(self) -> None:
        self._subject = subject_of(SCENE)

    def own(self, tolerance: float) -> Reached:
        """Our whole run; like theirs it keeps values at 1 kHz, but of all outputs."""
        values, _ = RECORDINGS["values"]
        prepared = PreparedScene(SCENE, communication_step=STEP, tolerance=tolerance, record=values)
        error = self._subject.error(self._subject.positions(completed(prepared.run())))
        return Reached(fastest(prepared.run), error)

    def radau(self, error: float) -> Reached:
        """SciPy's Radau on the compiled equations, at the loosest of `RADAU_TOLERANCES` that meets an error."""
        system, parts = system_of(self._subject)
        for tolerance in RADAU_TOLERANCES:
            run = scipy_run(self._subject, system, parts, "Radau", tolerance)
            reached = self._subject.error(run())
            if reached <= error:
                break
        return Reached(fastest(run), reached)

    def exudyn(self) -> tuple[Reached, Reached]:
        """Ours and Exudyn's ANCF beams for 1e-3 on the same robot: every link bends and stretches, with foreshortening, and
        damping is proportional to stiffness; each error is counted from the tool's own converged path."""
        scene = comparable(SCENE).replace(SHAPES | {"effects.foreshortening": True})
        own, other = exudyn_time.ours(scene), exudyn_time.exudyn(scene)
        return Reached(own.time, own.error), Reached(other.time, other.error)


def yardstick(folder: Path) -> float:
    """Processor time [s] of a fixed piece of arithmetic in C, so that figures of different machines can be compared."""
    source = Path(__file__).with_name("yardstick.c")
    compiler = find_compiler(native_platform())
    subprocess.run(
        [*compiler.command, "-O2", "-ffp-contract=off", str(source), "-o", "yardstick", "-lm"], cwd=folder, check=True
    )
    found = subprocess.run([str(folder / "yardstick")], check=True, capture_output=True, text=True)
    return float(json.loads(found.stdout))
