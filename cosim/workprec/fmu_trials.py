"""Trials with our own FMU and master: integrators, communication steps, orders of the inputs, coupling algorithms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from flexfmu.cosim.errors import CosimError
from flexfmu.cosim.experiment import PreparedScene
from flexfmu.cosim.workprec.subject import Subject, completed
from flexfmu.cosim.workprec.trial import Trial, fastest
from flexfmu.fmu_build.errors import BuildError
from flexfmu.model.loop_section import SampledSection

Announce = Callable[[str], None]
"""Told what is being tried."""

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)

CONTROLLED = ("automatic", "gauss2", "gauss3", "gauss4", "radau3", "dopri5")
"""Integrators with error control."""

FIXED_STEPS = (1e-4, 5e-5, 2e-5, 1e-5, 5e-6)
"""Of the classical Runge-Kutta method [s]."""

STEPS = (5e-3, 2e-3, 1e-3, 5e-4, 2e-4)
"""Communication steps [s]."""

ORDERS = (0, 1, 2, 3, 5, 9)
"""Degrees of the input polynomials: what a master can send, from values alone to two-point Hermite."""

TIGHT = 1e-10
"""Tolerance of the integrator where the coupling is looked at."""

FAILURES = (CosimError, BuildError)


def integrator_trials(
    subject: Subject,
    step: float,
    announce: Announce,
    controlled: Sequence[str] = CONTROLLED,
    fixed_steps: Sequence[float] = FIXED_STEPS,
) -> Iterator[Trial]:
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


def coupling_trials(subject: Subject, announce: Announce) -> Iterator[Trial]:
    """Communication steps for each order of the input polynomials, with a tight tolerance of the integrator."""
    for order in ORDERS:
        for step in STEPS:
            announce(f"communication step {1e3 * step:g} ms, inputs of degree {order}")
            options = {"communication_step": step, "tolerance": TIGHT, "input_order": order}
            yield fmu_trial(subject, "communication", f"inputs of degree {order}", f"{1e3 * step:g} ms", {}, options)


def algorithm_trials(subject: Subject, announce: Announce) -> Iterator[Trial]:
    """Coupling algorithms of the master over communication steps, for scenes with something to couple."""
    section = subject.scene.cosimulation
    samples = [each.sample_time for each in subject.scene.controller if isinstance(each, SampledSection)]
    for algorithm in ("gauss-seidel", "jacobi", "implicit"):
        for divisor in (1, 2, 4, 8):
            step = min([section.step, *samples]) / divisor
            announce(f"{algorithm}, communication step {1e3 * step:g} ms")
            scene: dict[str, object] = {"cosimulation.algorithm": algorithm}
            options = {"communication_step": step, "tolerance": 1e-9}
            yield fmu_trial(subject, "algorithms", algorithm, f"{1e3 * step:g} ms", scene, options)


def fmu_trial(
    subject: Subject,
    family: str,
    line: str,
    label: str,
    changes: Mapping[str, object],
    options: Mapping[str, Any],
) -> Trial:
    """One co-simulation: its error, and the time of master, FMU and recording once all is loaded."""
    try:
        scene = subject.scene.replace(dict(changes))
        prepared = PreparedScene(scene, motion=None if scene.shaper else subject.motion, **options)
        run = completed(prepared.run())
        error = subject.error(subject.positions(run))
    except FAILURES as failure:
        return Trial(family, line, label, None, None, " ".join(str(failure).split()))
    statistics = run.health.statistics
    note = ", ".join(f"{statistics[key]} {key}" for key in ("steps", "evaluations") if key in statistics)
    return Trial(family, line, label, error, fastest(prepared.run), note)
