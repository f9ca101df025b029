"""Ten thousand cycles in one run: whether time, energy or the closure of the mechanism drift."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import partial

import numpy as np
from numpy.typing import NDArray

from flexfmu.benchmarks.hard_cases.case import (
    LOOP_SIGNALS,
    CaseReport,
    Criterion,
    HardCase,
    fmu_of,
    paper_robot,
    soundness,
)
from flexfmu.benchmarks.hard_cases.scipy_solution import POSITION
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.cycles import repeated
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.model.numeric import numeric_model

CYCLES = 10_000

STEP = 1e-2
"""Communication step [s]; references are polynomials of degree 9 over each."""

DWELL = 0.02
"""Standstill between two motions [s]: links still swing when the next one begins."""

TOLERANCE = 1e-5
"""Relative tolerance of the FMU's integrator."""

SETTLED = 5
"""Number of cycles after which the initial transient has decayed and all cycles are alike."""

SCATTER = 100.0 * TOLERANCE
"""Largest difference of two cycles, relative: each may have errors of its own, which don't add up."""

DRIFT = TOLERANCE
"""Largest difference of the means over the first and the last half of the cycles, relative."""

LEAST_DIGITS = 4.0
"""Units in the last place by which the last instant may differ from its exact value."""


def cases(cycles: int = CYCLES) -> Iterator[HardCase]:
    """Yield the one case, with ``cycles`` cycles."""
    length = 2 * cycles * (paper_robot().trajectory.duration + DWELL)
    hard = f"{length:.0f} s at tolerance {TOLERANCE:g}: rounding and the integrator's errors could add up"
    yield HardCase(f"{cycles} cycles in one run", hard, partial(_run, cycles))


def _run(cycles: int) -> CaseReport:
    """Every cycle against the first settled one, at every breakpoint."""
    run = many_cycles(cycles)
    if not run.completed:
        return CaseReport(run.message, soundness(run))
    # (cycles, marks) rows of the left limits at the breakpoints of each cycle but for its first one
    points = np.append(np.array(run.plan.joints.breakpoints)[1:], run.plan.stop_time)
    index = np.searchsorted(run.recording.time, points).reshape(cycles, -1)
    # positions and energy there, relative to the deflection and to the largest energy
    positions = np.stack([run.recording[name].values for name in POSITION], axis=-1)[index]
    rigid = run.plan.task.evaluate(run.recording.time[index[0]], 0, "left")[0]
    size = float(np.linalg.norm(positions[SETTLED] - rigid, axis=-1).max())
    energy = link_energy(run, index.ravel()).reshape(index.shape)
    # last instant against exact arithmetic
    exact = 2 * cycles * (Fraction(run.plan.once.duration) + Fraction(DWELL))
    last = float(run.recording.time[-1])
    allowed = LEAST_DIGITS * float(np.spacing(last))
    checks = (
        Criterion("time off by", float(abs(Fraction(last) - exact)), allowed, "s"),
        *_drift("position", positions / size),
        *_drift("energy", energy[..., np.newaxis] / np.abs(energy).max()),
        *soundness(run),
    )
    steps = run.health.statistics["steps"]
    return CaseReport(f"{run.message}; {steps} steps of the integrator, all cycles alike", checks)


def many_cycles(cycles: int) -> Run:
    """Simulate the motion there and back, repeated."""
    scene = paper_robot().replace({"trajectory.dwell": DWELL})
    # recorded: the closure's signals, and states and rates for the energy
    states = numeric_model(scene).names
    kept = {*LOOP_SIGNALS, *states, *(f"der({name})" for name in states)}
    prepared = PreparedScene(
        scene,
        fmu_path=fmu_of(paper_robot()),
        communication_step=STEP,
        tolerance=TOLERANCE,
        motion=repeated(plan(scene), cycles),
        record=Selection(kept, 0),
    )
    return prepared.run()


def link_energy(run: Run, index: NDArray[np.intp]) -> RealArray:
    """(N,) energy of the links relative to straight ones at rest, with the joints locked at their angles [J]."""
    # states at the marks, joints locked at their angles
    model = numeric_model(run.scene)
    columns = run.recording.columns
    angles = [columns[f"joint{leg}.reference.position"].values[index] for leg in (1, 2)]
    u = np.vstack([*angles, np.zeros((4, index.size))])
    q, v = (np.stack([columns[form.format(name)].values[index] for name in model.names]) for form in ("{}", "der({})"))
    at_all = model.energy.map(index.size)
    bent, straight = (np.asarray(at_all(x, w, u)).sum(axis=0) for x, w in ((q, v), (0.0 * q, 0.0 * v)))
    return np.asarray(bent - straight)


def _drift(name: str, values: RealArray) -> tuple[Criterion, Criterion]:
    """The scatter of the cycles and their drift; values (cycles, marks, any), relative."""
    # the means over both halves tell a drift from scatter
    settled = values[SETTLED:]
    halves = np.array_split(settled, 2)
    drift = np.abs(halves[1].mean(axis=0) - halves[0].mean(axis=0)).max()
    return (
        Criterion(f"{name} of cycles differs by", float(np.abs(settled - settled[0]).max()), SCATTER),
        Criterion(f"{name} drifts by", float(drift), DRIFT),
    )
