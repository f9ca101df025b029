"""Robots and motions far from the paper's: payload, thickness and stiffness at their ends, stiff models, fast motions, jumps; and scenes
as users run them, judged by the errors that they state."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from math import nan, sqrt
from typing import Any

import numpy as np

from flexfmu.benchmarks.hard_cases.case import (
    ALLOWED,
    STEP,
    CaseReport,
    Criterion,
    HardCase,
    error_against,
    not_finite,
    paper_robot,
    run_case,
    soundness,
)
from flexfmu.benchmarks.hard_cases.scipy_solution import Solver
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.metrics.small_deflections import exceeded
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError

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


REFERENCES = ((1e-12, 1.0), (1e-11, 2.0))
"""Tolerances of two references, and multiples of a case's step; how far they are apart is what the first one can't tell."""

FINE_STEP = 1e-4
"""Communication step of the references [s], unless a case has its own."""

_LOOP: Mapping[str, Any] = {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}],
}
_PID: Mapping[str, Any] = {"kind": "pid", "proportional": 5e3, "integral": 5e4, "derivative": 50.0, "sample_time": 1e-3}
_STICKING: Mapping[str, Any] = {"effects.joint_friction": {"kind": "stiction", "coulomb": 2.0, "breakaway": 3.0}}
_MODULUS = "mechanism.material.youngs_modulus"

AS_A_USER: Mapping[str, tuple[str, Mapping[str, Any], float]] = {
    "impulse": (
        "10 kN for 10 µs at the end effector, between two samples",
        {
            **_LOOP,
            "disturbance": [
                {"kind": "pulse", "signal": "force.y", "amplitude": 1e4, "start": 0.2003, "duration": 1e-5}
            ],
        },
        FINE_STEP,
    ),
    "payload dropped between samples": (
        "6 kg vanish at 0.20037 s, under a controller of 1 kHz",
        {**_LOOP, "disturbance": [{"kind": "payload", "dropped": 0.20037}]},
        FINE_STEP,
    ),
    "stiction at rest under gravity": (
        "motors stick before and after the motion, whose controller pulls at them",
        {**_LOOP, **_STICKING, "trajectory.dwell": 1.0},
        FINE_STEP,
    ),
    "reference with jumps": (
        "accelerations of a bang-bang profile jump, a controller of 1 kHz follows",
        {**_LOOP, "trajectory.profile": {"kind": "bang-bang"}},
        FINE_STEP,
    ),
    "saturation with windup": (
        "an integral winds up while motors are limited to 60 % of the torque",
        {**_LOOP, "controller": [{**_PID, "anti_windup": "none", "torque_limit": 60.0}]},
        FINE_STEP,
    ),
    "chattering": (
        "velocity errors are over-corrected 2-fold in each sample, up to the torque limit, with stiction",
        {
            **_LOOP,
            **_STICKING,
            "controller": [{"kind": "pd", "proportional": 1e5, "derivative": 1e3, "sample_time": 2e-4}],
            "imperfection": [{"kind": "saturation", "limit": 150.0}],
            "trajectory.dwell": 0.0,
        },
        FINE_STEP,
    ),
    "near-singular start": ("legs 1.5 mm from being stretched", {"trajectory.start": [-0.175, 0.5549]}, FINE_STEP),
    **{
        f"Young's modulus of {young:g} Pa": (
            f"{(young / 70e9) ** 0.5:.2g} times the paper's frequencies",
            {_MODULUS: young},
            FINE_STEP,
        )
        for young in (1e6, 1e8, 1e13)
    },
    **{
        f"payload of {mass:g} kg": (f"{mass / 3.1:.2g} times the mass of the links", {"payload.mass": mass}, FINE_STEP)
        for mass in (1e-6, 1e3)
    },
    "a standstill of 1e5 s": (
        "1e5 communication steps of 1 s",
        {"trajectory.duration": 10.0, "trajectory.dwell": 1e5, "cosimulation.step": 1.0},
        0.1,
    ),
    **{
        f"tolerance {each:g}": (
            "the loosest there is" if each > 1e-6 else "ten digits more than any robot has",
            {"cosimulation.tolerance": each},
            FINE_STEP,
        )
        for each in (1e-2, 1e-12)
    },
    "communication steps of 0.1 µs": (
        "200000 of them, a shorter motion",
        {"cosimulation.step": 1e-7, "trajectory.duration": 0.02, "trajectory.dwell": 0.0},
        1e-5,
    ),
    "communication steps of 0.1 s": ("four of them in the whole motion", {"cosimulation.step": 0.1}, FINE_STEP),
}
"""Name → what makes it hard, changes of the paper's scene, and communication step of the references [s]."""


def stated_cases() -> Iterator[HardCase]:
    """Yield cases that run as a user runs them, and have to be right within the error that they state, or say in a sentence why not."""
    for name, (hard, changes, step) in AS_A_USER.items():
        yield HardCase(name, hard, partial(_within_stated, changes, step))


def _within_stated(changes: Mapping[str, Any], step: float) -> CaseReport:
    """Against runs at tolerances of 1e-11 and 1e-12."""
    run: Run | None
    try:
        run = run_scene(paper_robot().replace(dict(changes)))
        found = measure_run(run)
        message = run.message
    except (CosimError, SceneError, EquilibriumError, TrajectoryError) as refusal:
        run, message = None, str(refusal)
    # a refusal, or a run that ends early, is one sentence
    if run is None or not run.completed:
        return CaseReport(message, (Criterion("lines beyond one", float(message.count("\n")), 0.0),))
    exact, other = (
        measure_run(run_scene(run.scene, tolerance=each, communication_step=times * step), companions=0)
        for each, times in REFERENCES
    )
    ratios = list[float]()
    for name, one in found.items():
        values = exact[name].value, other[name].value
        if one.value is None or one.error is None or values[0] is None or values[1] is None:
            continue
        if abs(values[0] - values[1]) <= 0.5 * one.error:
            ratios.append(abs(one.value - values[0]) / one.error if one.error else 0.0)
    judged = f"{message}; metrics compared: {len(ratios)}"
    worst = max(ratios, default=nan)
    return CaseReport(judged, (Criterion("error over stated error", worst, 1.0), not_finite(run.recording)))
