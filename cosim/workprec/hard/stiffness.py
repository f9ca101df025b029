"""Stiff models: many modes, and damping that grows with the square of their frequency."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from flexfmu.cosim.workprec.hard.case import Finding, HardCase
from flexfmu.cosim.workprec.hard.judging import error_against, soundness
from flexfmu.cosim.workprec.hard.reference import Solver
from flexfmu.cosim.workprec.hard.robots import ALLOWED, STEP, paper_robot, run_case
from flexfmu.model.scene import Scene

REFERENCE = Solver("Radau", 1e-9, compiled=False)
"""Compiling these equations would take longer than interpreting them."""

LONG_STEP = 5e-3
"""Communication step [s]."""

DAMPING_TIME = 1e-4
"""[s]"""


def cases() -> Iterator[HardCase]:
    """Damped modes at long steps, and many modes."""
    decay = "the fastest mode decays at 6.7e6 /s, the slowest swings at 59 Hz; steps of 5 ms"
    many = "the fastest of 40 modes swings at 454 kHz, 7700 times as fast as the slowest"
    yield HardCase("stiffness damping, 6 + 6 modes", decay, partial(_run, damped_robot, LONG_STEP))
    yield HardCase("20 bending modes", many, partial(_run, many_modes_robot, STEP))


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


def _run(robot: Callable[[], Scene], step: float) -> Finding:
    """Against Radau on the same equations."""
    run = run_case(robot(), step=step)
    steps = f"{run.health.statistics['steps']} steps of the integrator"
    checks = error_against(run, robot(), REFERENCE, ALLOWED), *soundness(run)
    return Finding(f"{run.message}; {steps}", checks)
