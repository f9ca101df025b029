"""What `speed.py` measures: processor times of whole runs, of the master alone, of many variants, and of other tools."""

from __future__ import annotations

import itertools
import json
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import fmu_cost
import numpy as np
from idle import IdlePlant, idle_fmu
from paper_scene import SCENE, SCENES, Timed, best_times, run_with, timed, whole_run

from flexfmu.cosim.experiment import PreparedScene
from flexfmu.cosim.fmu.slave import FmuSlave
from flexfmu.cosim.master.selection import Selection
from flexfmu.cosim.scene_run import Run
from flexfmu.cosim.variants import run_variants
from flexfmu.cosim.workprec.exudyn_peer import run_exudyn
from flexfmu.cosim.workprec.solver_trials import scipy_run, system_of
from flexfmu.cosim.workprec.subject import completed, subject_of
from flexfmu.cosim.workprec.trial import fastest
from flexfmu.fmu_build.platforms import native_platform
from flexfmu.fmu_build.scene_build import build_scene
from flexfmu.fmu_build.toolchain import find_compiler

STEP = 1e-3
"""Communication step of all runs [s]: recording at 1 kHz."""

TOLERANCES = (1e-3, 1e-5)
SHORT_STEP = 1e-4
"""The master's cost of a step is what runs with this step take longer than those with `STEP`, for each step more [s]."""

PAYLOADS = np.linspace(0.0, 8.0, 100)
DURATIONS = np.linspace(0.35, 0.6, 10)
"""The variants: 1,000 in all [kg, s]."""

RADAU_TOLERANCES = (1e-4, 1e-5, 1e-6)
EXUDYN_ELEMENTS, EXUDYN_STEP = 2, 1e-3 / 32
"""Two elements a link give the paths that eight do, to 2e-5; with this step they are within 1e-3 of those of ever shorter
steps [s]."""


@dataclass(frozen=True)
class Whole:
    """One scene at one tolerance: processor times [s] and the FMU's counters.

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


def whole_runs(folder: Path, repeat: int) -> dict[tuple[int, float], Whole]:
    """(degrees of freedom, tolerance) → what it costs; times of all of them in turn."""
    cases = list(itertools.product(SCENES, TOLERANCES))
    inner_costs = {n: InnerCost(n, folder) for n in SCENES}
    runs = [whole_run(SCENES[n], STEP, tolerance) for n, tolerance in cases]
    inner: dict[tuple[int, float], dict[str, float]] = {}
    best = [np.inf] * len(cases)
    for _ in range(3):
        best = np.minimum(best, best_times(runs, max(1, repeat // 3))).tolist()
        for case in cases:
            found = inner_costs[case[0]].run(case[1], max(1, repeat // 3))
            inner[case] = {name: min(value, inner.get(case, found)[name]) for name, value in found.items()}
    return {case: _whole(inner_costs[case[0]].steps, time, inner[case]) for case, time in zip(cases, best, strict=True)}


def _whole(steps: int, time: float, found: Mapping[str, float]) -> Whole:
    floor = fmu_cost.floors(found, steps)["whole_floor"]
    return Whole(
        time, found["integration"], found["whole"], floor, {name: int(found[name]) for name in fmu_cost.COUNTERS}
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


def overheads(folder: Path, repeat: int) -> dict[str, float]:
    """The master's time [s] for each communication step, trajectory and recording included, by what the plant is."""
    real = build_scene(SCENE).path
    idle = idle_fmu(real, folder)
    plants = {"compiled": FmuSlave(idle, "plant"), "python": IdlePlant(FmuSlave(real, "plant"))}
    runs: list[Timed] = [run_with(plant, step) for plant in plants.values() for step in (STEP, SHORT_STEP)]
    times = np.reshape(best_times(runs, repeat), (-1, 2))
    stop = PreparedScene(SCENE, fmu_path=real).stop_time
    more = stop / SHORT_STEP - stop / STEP
    return {name: float(short - long) / more for name, (long, short) in zip(plants, times, strict=True)}


def peak_torque(run: Run) -> float:
    """What is measured of each variant."""
    return float(np.abs(run.recording["joint1.torque"].values).max())


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
            communication_step=STEP,
            tolerance=1e-3,
            record=Selection(["joint1.torque"], order=0),
        )
        for each in found:
            if each.error is not None:
                raise each.error

    return timed(all_of_them)()


@dataclass(frozen=True)
class Reached:
    """What another tool needs: processor time [s], and the error that it then has, relative to what elasticity does."""

    time: float
    error: float


class Peers:
    """The same motion by other tools, with errors in positions at multiples of 1 ms."""

    def __init__(self) -> None:
        self._subject = subject_of(SCENE)

    def own(self, tolerance: float) -> Reached:
        """Our whole run."""
        prepared = PreparedScene(SCENE, communication_step=STEP, tolerance=tolerance)
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

    @cached_property
    def exudyn(self) -> Reached:
        """Exudyn's ANCF beams; its error is that of a fixed step of second order, a third of the change from twice the step."""
        s = self._subject
        double, _ = run_exudyn(s.scene, s.motion, s.instants, 2.0 * EXUDYN_STEP, EXUDYN_ELEMENTS)
        single, time = run_exudyn(s.scene, s.motion, s.instants, EXUDYN_STEP, EXUDYN_ELEMENTS)
        return Reached(time, float(np.linalg.norm(single - double, axis=1).max()) / s.scale / 3.0)


def yardstick(folder: Path) -> float:
    """Processor time [s] of a fixed piece of arithmetic in C, so that figures of different machines can be compared."""
    source = Path(__file__).with_name("yardstick.c")
    compiler = find_compiler(native_platform())
    subprocess.run(
        [*compiler.command, "-O2", "-ffp-contract=off", str(source), "-o", "yardstick", "-lm"], cwd=folder, check=True
    )
    found = subprocess.run([str(folder / "yardstick")], check=True, capture_output=True, text=True)
    return float(json.loads(found.stdout))
