"""Robots and motions far from the paper's: payload, thickness and stiffness at their ends, stiff models, fast motions, jumps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from math import sqrt
from typing import Any

import numpy as np

from flexfmu.benchmarks.hard_cases.case import (
    ALLOWED,
    STEP,
    CaseReport,
    Criterion,
    HardCase,
    error_against,
    paper_robot,
    run_case,
    soundness,
)
from flexfmu.benchmarks.hard_cases.scipy_solution import Solver
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.small_deflections import exceeded
from flexfmu.model.scene.schema import Scene

STIFF = Solver("LSODA", 1e-11)
"""Stiff: heavy payloads on light links swing slowly, the links themselves fast."""


def parameter_cases() -> Iterator[HardCase]:
    """Yield cases with extreme payload, link diameter and material."""
    rods = "mechanism.proximal.diameter", "mechanism.distal.diameter"
    modulus = "mechanism.material.youngs_modulus"
    # from nothing to ten times the payload
    yield _case("no payload", "0 kg at the end effector: it has no mass of its own", {"payload.mass": 0.0})
    yield _case("payload of 60 kg", "19 times the mass of the links", {"payload.mass": 60.0}, bent=True)
    # rods from wires to beams
    yield _case(
        "rods of 5 mm",
        "bending stiffness 2400 times lower, 6 kg on 0.066 kg of links",
        dict.fromkeys(rods, 0.005),
        bent=True,
    )
    yield _case("rods of 80 mm", "bending stiffness 27 times higher", dict.fromkeys(rods, 0.08))
    # links from rubber to what no material reaches
    yield _case("Young's modulus x 1e-3", "70 MPa: links like rubber", {modulus: 70e6}, bent=True)
    yield _case(
        "Young's modulus x 1e3", "70 TPa: modes at 32 times the frequency, deflections of 0.2 µm", {modulus: 70e12}
    )


def _case(name: str, hard: str, changes: Mapping[str, Any], bent: bool = False) -> HardCase:
    return HardCase(name, hard, partial(_run_with_parameters, changes, bent))


def _run_with_parameters(changes: Mapping[str, Any], bent: bool) -> CaseReport:
    """Against LSODA on the same equations; large deflections must cause a warning."""
    run = run_case(paper_robot(), changes)
    # a warning is expected exactly where links bend far
    warnings = exceeded(run)
    warned = Criterion("warnings of large deflections missing", float(bent != bool(warnings)), 0.0)
    checks = (error_against(run, paper_robot(), STIFF, ALLOWED), *soundness(run), warned)
    return CaseReport("; ".join([run.message, *warnings]), checks)


IMPLICIT = Solver("Radau", 1e-9, compiled=False)
"""Compiling these equations would take longer than interpreting them."""

LONG_STEP = 5e-3
"""Communication step [s]."""

DAMPING_TIME = 1e-4
"""[s]"""


def stiffness_cases() -> Iterator[HardCase]:
    """Yield cases with damped modes at long communication steps, and with many modes."""
    decay = "the fastest mode decays at 6.7e6 /s, the slowest swings at 59 Hz; steps of 5 ms"
    many = "the fastest of 40 modes swings at 454 kHz, 7700 times as fast as the slowest"
    yield HardCase("stiffness damping, 6 + 6 modes", decay, partial(_run_stiff, damped_robot, LONG_STEP))
    yield HardCase("20 bending modes", many, partial(_run_stiff, many_modes_robot, STEP))


def damped_robot() -> Scene:
    """6 bending and 6 axial modes in each leg, damped in proportion to their stiffness."""
    return paper_robot().replace(
        {
            "effects.proximal_bending": 6,
            "effects.distal_axial": 6,
            "effects.damping": {"kind": "stiffness", "time": DAMPING_TIME},
        }
    )


def many_modes_robot() -> Scene:
    """20 bending modes in each proximal link."""
    return paper_robot().replace({"effects.proximal_bending": 20, "effects.distal_axial": 0})


def _run_stiff(robot: Callable[[], Scene], step: float) -> CaseReport:
    """Against Radau on the same equations."""
    run = run_case(robot(), step=step)
    steps = f"{run.health.statistics['steps']} steps of the integrator"
    checks = error_against(run, robot(), IMPLICIT, ALLOWED), *soundness(run)
    return CaseReport(f"{run.message}; {steps}", checks)


EXPLICIT = Solver("DOP853", 1e-10)

STANDARD_GRAVITY = 9.80665

ODD_STEP = 7.3e-4
"""Communication step [s] of which no breakpoint of a motion of 0.43 s is a multiple."""


def motion_cases() -> Iterator[HardCase]:
    """Yield cases with fast motions, acceleration jumps, a start out of equilibrium, and no dwell."""
    # fast motions
    for gravities in (15, 26):
        peak = f"peak acceleration {gravities * STANDARD_GRAVITY:.0f} m/s2 with 6 kg"
        yield HardCase(f"motion at {gravities} g", peak, partial(_fast, gravities))
    yield HardCase(
        "bang-bang, step that doesn't fit",
        f"acceleration jumps within steps of {1e3 * ODD_STEP:g} ms",
        partial(
            _run_motion, {"trajectory.profile": {"kind": "bang-bang"}}, ODD_STEP, lambda run: (_jumps_missed(run),)
        ),
    )
    yield HardCase(
        "start away from equilibrium",
        "links start straight: the weight of 6 kg comes at once",
        partial(_run_motion, {"cosimulation.initial": "undeformed"}),
    )
    yield HardCase(
        "no dwell",
        "a standstill of 0 s: the run ends at a breakpoint",
        partial(_run_motion, {"trajectory.dwell": 0.0}, STEP, lambda run: (_end_missed(run),)),
    )


def _fast(gravities: float) -> CaseReport:
    """Run the same path with a peak acceleration of ``gravities`` g."""
    # accelerations go with the inverse square of the duration
    slow = plan(paper_robot())
    instants = np.linspace(0.0, slow.duration, 4001)
    peak = float(np.linalg.norm(slow.task.evaluate(instants, 2)[2], axis=1).max())
    return _run_motion({"trajectory.duration": slow.duration * sqrt(peak / (gravities * STANDARD_GRAVITY))})


def _jumps_missed(run: Run) -> Criterion:
    """Every jump must be there twice, at its own instant."""
    time = run.recording.time
    twice = time[1:][np.diff(time) == 0.0]
    missing = [point for point in run.plan.joints.breakpoints if not np.any(twice == point)]
    return Criterion("jumps not landed on", float(len(missing)), 0.0)


def _end_missed(run: Run) -> Criterion:
    """The last instant is the end of the motion, to the bit."""
    return Criterion("error of the last instant", abs(float(run.recording.time[-1]) - run.plan.duration), 0.0, "s")


def _run_motion(
    changes: Mapping[str, Any], step: float = STEP, more: Callable[[Run], tuple[Criterion, ...]] = lambda run: ()
) -> CaseReport:
    """Against an explicit method on the same equations."""
    run = run_case(paper_robot(), changes, step=step)
    checks = error_against(run, paper_robot(), EXPLICIT, ALLOWED), *soundness(run), *more(run)
    return CaseReport(run.message, checks)
