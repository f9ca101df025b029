"""Trials with our own FMU and master: integrators, communication steps, orders of the inputs, coupling algorithms; and the fidelity
ladder: what leaving effects out costs in accuracy, and saves in time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.experiment.prepared_scene import PreparedScene
from flexfmu.cosim.experiment.timing import fastest, fastest_in_turns
from flexfmu.cosim.studies.workprec.trial import SceneUnderTest, WorkPrecisionTrial, completed
from flexfmu.fmu_build.errors import BuildError
from flexfmu.model.scene.loop import SampledSection

Announce = Callable[[str], None]
"""Function of a sentence on the current trial."""

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)

CONTROLLED = ("automatic", "gauss2", "gauss3", "gauss4", "radau3", "dopri5")
"""Integrators with error control."""

FIXED_STEPS = (1e-4, 5e-5, 2e-5, 1e-5, 5e-6)
"""Fixed steps of the classical Runge-Kutta method [s]."""

STEPS = (5e-3, 2e-3, 1e-3, 5e-4, 2e-4)
"""Communication steps [s]."""

ORDERS = (0, 1, 2, 3, 5, 9)
"""Degrees of the input polynomials: what a master can send, from values alone to two-point Hermite."""

TIGHT = 1e-10
"""Relative tolerance of the integrator in coupling trials."""

FAILURES = (CosimError, BuildError)


def integrator_trials(
    subject: SceneUnderTest,
    step: float,
    announce: Announce,
    controlled: Sequence[str] = CONTROLLED,
    fixed_steps: Sequence[float] = FIXED_STEPS,
) -> Iterator[WorkPrecisionTrial]:
    """Integrators over tolerances, and the classical one over fixed steps [s], at one communication step [s]."""
    for name in controlled:
        for tolerance in TOLERANCES:
            announce(f"{name}, tolerance {tolerance:.0e}")
            scene: dict[str, object] = {"cosimulation.integrator": name}
            options = {"communication_step": step, "tolerance": tolerance}
            yield fmu_trial(subject, "integrators", name, f"{tolerance:.0e}", scene, options)
    for fixed in fixed_steps:
        announce(f"rk4, step {fixed:g} s")
        scene = {"cosimulation.integrator": "rk4", "cosimulation.integrator_step": fixed}
        yield fmu_trial(subject, "integrators", "rk4", f"{1e6 * fixed:g} µs", scene, {"communication_step": step})


def coupling_trials(subject: SceneUnderTest, announce: Announce) -> Iterator[WorkPrecisionTrial]:
    """Communication steps for each order of the input polynomials, with a tight tolerance of the integrator."""
    for order in ORDERS:
        for step in STEPS:
            announce(f"communication step {1e3 * step:g} ms, inputs of degree {order}")
            options = {"communication_step": step, "tolerance": TIGHT, "input_order": order}
            yield fmu_trial(subject, "communication", f"inputs of degree {order}", f"{1e3 * step:g} ms", {}, options)


def algorithm_trials(subject: SceneUnderTest, announce: Announce) -> Iterator[WorkPrecisionTrial]:
    """Coupling algorithms of the master over communication steps, for scenes with something to couple."""
    section = subject.scene.cosimulation
    samples = [each.sample_time for each in subject.scene.controller if isinstance(each, SampledSection)]
    for algorithm in ("gauss-seidel", "jacobi", "implicit"):
        for divisor in (1, 2, 4, 8):
            # steps divide the sample times
            step = min([section.communication_step, *samples]) / divisor
            announce(f"{algorithm}, communication step {1e3 * step:g} ms")
            scene: dict[str, object] = {"cosimulation.algorithm": algorithm}
            options = {"communication_step": step, "tolerance": 1e-9}
            yield fmu_trial(subject, "algorithms", algorithm, f"{1e3 * step:g} ms", scene, options)


def fmu_trial(
    subject: SceneUnderTest,
    family: str,
    line: str,
    label: str,
    changes: Mapping[str, object],
    options: Mapping[str, Any],
) -> WorkPrecisionTrial:
    """One co-simulation: its error, and the time of master, FMU and recording once all is loaded."""
    try:
        scene = subject.scene.replace(dict(changes))
        prepared = PreparedScene(scene, motion=None if scene.shaper else subject.motion, **options)
        run = completed(prepared.run())
        error = subject.error(subject.positions(run))
    except FAILURES as failure:
        return WorkPrecisionTrial(family, line, label, None, None, " ".join(str(failure).split()))
    statistics = run.health.statistics
    note = ", ".join(f"{statistics[key]} {key}" for key in ("steps", "evaluations") if key in statistics)
    return WorkPrecisionTrial(family, line, label, error, fastest(prepared.run), note)


RIGID: Mapping[str, object] = {
    "effects.proximal_bending": 0,
    "effects.proximal_axial": 0,
    "effects.distal_bending": 0,
    "effects.distal_axial": 0,
    "effects.quasi_static": [],
}

RICH: Mapping[str, object] = {
    "effects.basis": "craig-bampton",
    "effects.proximal_bending": 4,
    "effects.proximal_axial": 2,
    "effects.distal_bending": 3,
    "effects.distal_axial": 3,
    "effects.quasi_static": [],
}
"""The richest set, the reference of the ladder: all families, static and fixed-interface shapes until nothing changes any more."""


@dataclass(frozen=True)
class Rung:
    """A set of effects.

    Attributes:
        line: line of the diagram.
        label: name of the set.
        changes: changes of the rigid scene.
    """

    line: str
    label: str
    changes: Mapping[str, object]


def ladder() -> tuple[Rung, ...]:
    """Return the rungs of the fidelity ladder, from rigid links to more families of shapes."""
    # assumed modes, one family after the other
    bending = [{"effects.proximal_bending": k} for k in (1, 2, 3)]
    axial = bending[2] | {"effects.distal_axial": 3}
    both = axial | {"effects.distal_bending": 1}
    # static shapes need fewer coordinates
    static: dict[str, object] = {"effects.basis": "craig-bampton"}
    one_each = static | {"effects.proximal_bending": 1, "effects.distal_axial": 1}
    families = ["proximal_bending", "distal_axial"]
    return (
        Rung("assumed modes", "rigid", {}),
        Rung("assumed modes", "1 bending", bending[0]),
        Rung("assumed modes", "2 bending", bending[1]),
        Rung("assumed modes", "3 bending", bending[2]),
        Rung("assumed modes", "3 + 3 axial", axial),
        Rung("assumed modes", "3 + 3 + 1 distal bending", both),
        Rung("static shapes", "quasi-static 1 + 1", one_each | {"effects.quasi_static": families}),
        Rung("static shapes", "1 + 1 axial", one_each),
        Rung("static shapes", "1 + 1 + 1 distal bending", one_each | {"effects.distal_bending": 1}),
    )


def effect_trials(
    subject: SceneUnderTest, step: float, tolerance: float, announce: Announce
) -> Iterator[WorkPrecisionTrial]:
    """Every rung, its error against the richest set, its time in turns with the others; the scene's damping and loads stay."""
    announce("richest set of effects")
    options = {"communication_step": step, "tolerance": tolerance}
    # errors are relative to the richest set instead of the scene's own model
    rich = PreparedScene(subject.scene.replace(dict(RICH)), motion=subject.motion, **options)  # type: ignore[arg-type]
    truth = replace(subject)
    truth.__dict__["reference"] = subject.positions(completed(rich.run()))
    # errors first
    runs: list[tuple[WorkPrecisionTrial, PreparedScene]] = []
    for rung in ladder():
        announce(f"effects: {rung.line}, {rung.label}")
        trial, prepared = _rung_trial(truth, rung, options)
        if prepared is None:
            yield trial
        else:
            runs.append((trial, prepared))
    # then times, in turns, so that load on the machine hits all rungs alike
    announce("effects: times")
    times = fastest_in_turns([prepared.run for _, prepared in runs])
    yield from (replace(trial, time=time) for (trial, _), time in zip(runs, times, strict=True))


def _rung_trial(
    truth: SceneUnderTest, rung: Rung, options: Mapping[str, float]
) -> tuple[WorkPrecisionTrial, PreparedScene | None]:
    """A rung's error, and its run where there is one to be timed."""
    try:
        scene = truth.scene.replace({**RIGID, **rung.changes})
        prepared = PreparedScene(scene, motion=truth.motion, **options)  # type: ignore[arg-type]
        positions = truth.positions(completed(prepared.run()))
    except FAILURES as failure:
        return WorkPrecisionTrial("effects", rung.line, rung.label, None, None, " ".join(str(failure).split())), None
    if np.isnan(positions).all():
        return WorkPrecisionTrial("effects", rung.line, rung.label, None, None, "no positions"), None
    return WorkPrecisionTrial("effects", rung.line, rung.label, truth.error(positions), None), prepared
