"""Fastest joint references within limits that hold for several variants of a robot.

The first stage has few variants and a loose bound on the residual vibration; the bound then falls, with more variants. In the end
all variants are evaluated on a finer grid: its end state corrects that of the coarse one, the worst variants join the others, and
what still lies between them tightens the limits. The steps are in `motion_stage`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flexfmu.model.reference_design.elastic_response import FleetResponse
from flexfmu.model.reference_design.joint_spline import JointSpline
from flexfmu.model.reference_design.motion_stage import GROUPS, PENALTY, MotionLimits, Stage, State
from flexfmu.model.reference_design.variants import RobotVariant

LOOSE, FALL = 2e-5, 4.0
"""Bound of the residual vibration [m] in the first stages, and about how much it falls from each to the next."""

NODES = 9
"""Number of variants that the programmes have: 7 payloads within 30 % leave 1 µm of residual vibration between them."""

CHECKED = np.array([3e-4, 1e-4, 1e-4, 1e-4, 1.5e-2, 1e-3])
"""Violations, in the order of `GROUPS`, up to which the limits count as met on the fine grid: 15 µm, and 5 % of the residual."""

ROUNDS = 4
"""Largest number of evaluations of all variants on the fine grid."""

FINER = 2
"""How much finer that grid is."""


@dataclass(frozen=True, eq=False)
class Improvement:
    """A motion on the way to the fastest one.

    Attributes:
        motion: the joint references.
        violations: largest relative violation of each of `GROUPS` among the variants that were considered; 0 where it is met.
        residual: bound of the displacement of the end effector by vibration after the motion, of these variants [m].
        checked: whether all variants meet all limits on the fine grid.
    """

    motion: JointSpline
    violations: Mapping[str, float]
    residual: float
    checked: bool


def fastest_motion(
    robots: Sequence[RobotVariant],
    limits: MotionLimits,
    start: JointSpline,
    nodes: Sequence[int] | None = None,
    *,
    parts: int = 2,
    iterations: int = 40,
    loose: float = LOOSE,
) -> Iterator[Improvement]:
    """Joint references that are faster and faster within limits that hold for all robots.

    Args:
        robots: the robots; those of one scene follow each other, by payload.
        limits: the limits, with torques for all robots.
        start: first motion; it may violate limits, and half the duration of a usual motion serves well.
        nodes: indices of the robots that the programmes have; None for `NODES` that are denser near both ends.
        parts: steps of the integration for each interval of the spline.
        iterations: largest number of programmes in each stage.
        loose: bound of the residual vibration [m] in the first stages; the last bound is the least.

    Yields:
        Motions on the way; the last one with ``checked`` is the fastest that meets all limits.

    Raises:
        EquilibriumError: the first motion has no elastic motion.
    """
    chosen = np.array(spread(len(robots), NODES) if nodes is None else nodes)
    motion, loose = start, max(limits.residual, loose)
    # few variants, then all nodes, with a bound that falls
    levels = max(1, round(math.log(loose / limits.residual, FALL)))
    bounds = np.geomspace(loose, limits.residual, levels + 1)[:-1].tolist()
    stages = [(chosen[spread(len(chosen), 3)], loose), *((chosen, bound) for bound in bounds)]
    penalty = PENALTY[0]
    for few, residual in stages:
        stage = _stage(robots, replace(limits, residual=residual), motion, few, start.duration, parts)
        for state in stage.improvements(motion, iterations, penalty):
            motion = state.motion
            yield _improvement(stage, state)
        penalty = max(PENALTY[0], min(4.0 * stage.penalty, 10.0))
    # all variants on the fine grid
    fine = _stage(robots, limits, motion, np.arange(len(robots)), start.duration, FINER * parts)
    tight, exact = limits, fine.state(motion, derivatives=False)
    for _ in range(ROUNDS):
        stage = _stage(robots, tight, motion, chosen, start.duration, parts)
        stage.vibration.error = exact.response.end[chosen] - stage.state(motion, derivatives=False).response.end
        for state in stage.improvements(motion, iterations, penalty):
            motion = state.motion
            yield _improvement(stage, state)
        exact = fine.state(motion, derivatives=False)
        met = bool((exact.violations <= CHECKED).all())
        yield replace(_improvement(fine, exact), checked=met)
        if met:
            return
        # the worst variants join the nodes, and what else lies between them tightens the limits
        residuals = fine.vibration.largest(exact.response.end)
        loads = (np.abs(exact.response.torque).max(axis=1) / limits.torque).max(axis=1)
        share = float(max(residuals[chosen].max(), tight.residual) / residuals.max())
        torque = tight.torque * (0.9998 / max(float(loads.max()), 1.0))
        tight = replace(tight, torque=torque, residual=tight.residual * float(np.clip(share, 0.5, 0.95)))
        chosen = np.unique([*chosen, residuals.argmax(), loads.argmax()])


def spread(count: int, number: int) -> list[int]:
    """Indices of a number of things in a row of a count, denser near both ends (Chebyshev's nodes)."""
    nodes = 0.5 - 0.5 * np.cos(np.pi * (np.arange(number) + 0.5) / number) / np.cos(0.5 * np.pi / number)
    return sorted({int(k) for k in np.rint(nodes * (count - 1))}) if number > 1 else [(count - 1) // 2]


def _stage(
    robots: Sequence[RobotVariant],
    limits: MotionLimits,
    motion: JointSpline,
    chosen: NDArray[np.intp],
    unit: float,
    parts: int,
) -> Stage:
    elastic = FleetResponse([robots[int(k)] for k in chosen], motion.coefficients[0], parts * motion.intervals)
    return Stage(elastic, replace(limits, torque=limits.torque[chosen]), motion, unit)


def _improvement(stage: Stage, state: State) -> Improvement:
    residual = float(stage.vibration.largest(state.response.end).max(initial=0.0))
    return Improvement(state.motion, dict(zip(GROUPS, state.violations.tolist(), strict=True)), residual, checked=False)
