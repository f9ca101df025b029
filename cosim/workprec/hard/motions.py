"""Motions that are hard: fast ones, ones whose acceleration jumps, and starts that are far from equilibrium."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from math import sqrt
from typing import Any

import numpy as np

from flexfmu.cosim.planning import plan
from flexfmu.cosim.scene_run import Run
from flexfmu.cosim.workprec.hard.case import Check, Finding, HardCase
from flexfmu.cosim.workprec.hard.judging import error_against, soundness
from flexfmu.cosim.workprec.hard.reference import Solver
from flexfmu.cosim.workprec.hard.robots import ALLOWED, STEP, paper_robot, run_case

EXPLICIT = Solver("DOP853", 1e-10)

STANDARD_GRAVITY = 9.80665

ODD_STEP = 7.3e-4
"""Communication step [s] of which no breakpoint of a motion of 0.43 s is a multiple."""


def cases() -> Iterator[HardCase]:
    """Accelerations, jumps, starts, dwells."""
    for gravities in (15, 26):
        peak = f"peak acceleration {gravities * STANDARD_GRAVITY:.0f} m/s2 with 6 kg"
        yield HardCase(f"motion at {gravities} g", peak, partial(_fast, gravities))
    yield HardCase(
        "bang-bang, step that doesn't fit",
        f"acceleration jumps within steps of {1e3 * ODD_STEP:g} ms",
        partial(_run, {"trajectory.profile": {"kind": "bang-bang"}}, ODD_STEP, lambda run: (_jumps_missed(run),)),
    )
    yield HardCase(
        "start away from equilibrium",
        "links start straight: the weight of 6 kg comes at once",
        partial(_run, {"cosimulation.initial": "undeformed"}),
    )
    yield HardCase(
        "no dwell",
        "a standstill of 0 s: the run ends at a breakpoint",
        partial(_run, {"trajectory.dwell": 0.0}, STEP, lambda run: (_end_missed(run),)),
    )


def _fast(gravities: float) -> Finding:
    """The same path, as fast as it takes."""
    slow = plan(paper_robot())
    instants = np.linspace(0.0, slow.duration, 4001)
    peak = float(np.linalg.norm(slow.task.evaluate(instants, 2)[2], axis=1).max())
    return _run({"trajectory.duration": slow.duration * sqrt(peak / (gravities * STANDARD_GRAVITY))})


def _jumps_missed(run: Run) -> Check:
    """Every jump must be there twice, at its own instant."""
    time = run.recording.time
    twice = time[1:][np.diff(time) == 0.0]
    missing = [point for point in run.plan.joints.breakpoints if not np.any(twice == point)]
    return Check("jumps not landed on", float(len(missing)), 0.0)


def _end_missed(run: Run) -> Check:
    """The last instant is the end of the motion, to the bit."""
    return Check("error of the last instant", abs(float(run.recording.time[-1]) - run.plan.duration), 0.0, "s")


def _run(
    changes: Mapping[str, Any], step: float = STEP, more: Callable[[Run], tuple[Check, ...]] = lambda run: ()
) -> Finding:
    """Against an explicit method on the same equations."""
    run = run_case(paper_robot(), changes, step=step)
    checks = error_against(run, paper_robot(), EXPLICIT, ALLOWED), *soundness(run), *more(run)
    return Finding(run.message, checks)
