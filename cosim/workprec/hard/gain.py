"""A controller whose gain is too high for the step at which it is coupled to the robot."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexfmu.cosim.experiment import run_scene
from flexfmu.cosim.master.outcome import Outcome
from flexfmu.cosim.scene_run import Run
from flexfmu.cosim.workprec.hard.case import Check, Finding, HardCase
from flexfmu.cosim.workprec.hard.judging import not_finite
from flexfmu.cosim.workprec.hard.robots import STEP, fmu_of, paper_robot
from flexfmu.model.scene import Scene

INERTIA = 0.1
"""Of each motor [kg.m2]."""

PROPORTIONAL, DERIVATIVE = 1e4, 300.0
"""Gains [N.m/rad], [N.m.s/rad]."""

SHORT_STEP = 1e-4
"""Step and sample time [s] at which the same gains are right."""

STEPS = (STEP, SHORT_STEP)

TRACKING = 0.05
"""Largest error of the joints [rad] of a loop that is stable: a tenth of what they move."""

NAMED = ("unstable", "plant", "pd", " s: ")
"""What the status has to name: what is wrong, between whom, since when."""


def cases() -> Iterator[HardCase]:
    """One."""
    overshoot = DERIVATIVE * STEP / INERTIA
    hard = f"a velocity error is over-corrected {overshoot:.0f}-fold in every step of {1e3 * STEP:g} ms"
    yield HardCase("gain too high, coupled by Jacobi", hard, _unstable)


def controlled_robot(step: float) -> Scene:
    """Robot with motors and PD controller, side by side."""
    controller = {"kind": "pd", "proportional": PROPORTIONAL, "derivative": DERIVATIVE, "sample_time": step}
    return paper_robot().replace(
        {
            "cosimulation.drive": "torque",
            "cosimulation.algorithm": "jacobi",
            "cosimulation.step": step,
            "effects.motor_inertia": INERTIA,
            "effects.proximal_bending": 1,
            "effects.distal_axial": 1,
            "controller": [controller],
        }
    )


def _unstable() -> Finding:
    """Reported as what it is, and cured by what the report says."""
    run, cured = (run_scene(controlled_robot(step), fmu_path=fmu_of(controlled_robot(STEP))) for step in STEPS)
    unnamed = sum(part not in run.message for part in NAMED)
    checks = (
        Check("outcomes other than an unstable coupling", float(run.outcome is not Outcome.COUPLING_UNSTABLE), 0.0),
        Check("slaves or time not named", float(unnamed), 0.0),
        not_finite(run.recording),
        Check(f"tracking error in steps of {1e3 * SHORT_STEP:g} ms", _tracking_error(cured), TRACKING, "rad"),
    )
    return Finding(run.message, checks)


def _tracking_error(run: Run) -> float:
    """Largest [rad]; NaN for a run that didn't reach its end."""
    if not run.completed:
        return float("nan")
    names = ((f"joint{leg}.position", f"joint{leg}.reference.position") for leg in (1, 2))
    return max(float(np.abs(run.recording[a].values - run.recording[b].values).max()) for a, b in names)
