"""Optimal control as a method of the planner: the fastest motion, or that of least effort, for the robot as it is and for its bands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.clearance import Polygon
from flexfmu.cosim.design.plans.goals import RATES, Goals
from flexfmu.cosim.design.plans.robust_optimal import PAYLOADS, TRIES, excesses, robust_optimal
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.model.reference_design.control_rows import Area, ReferenceLimits, RobotLimits
from flexfmu.model.reference_design.joint_spline import JointSpline, fitted
from flexfmu.model.reference_design.optimal_control import COARSE, optimal_motions
from flexfmu.model.reference_design.time_optimal import spread
from flexfmu.trajectories.jets import RealArray

ROBOTS = 5
"""Robots that stand for a band of payloads where something else than time is minimised."""

SIDES = 0.3
"""How far beyond the given motion, relative to its width, the end effector may go where regions are stated by the user."""

RESERVE = 0.97
"""Share of the margin that motions use."""

CHUNK = 2000
"""Points whose distances are computed together."""

RETURN = 1e-6
"""Distance from start to end [m] below which a motion returns."""


def optimal(goals: Goals, found: Sequence[Assessment], processes: int, show: ShowProgress) -> Iterator[Candidate]:
    """Motions by optimal control, from the given one on; see `planner.Stage`."""
    if np.hypot(*(goals.trace[-1] - goals.trace[0])) < RETURN:
        raise InputError("optimal control plans a motion from one place to another, and this one ends where it starts")
    given, wishes, every = found[0], goals.wishes, robots_of(goals, found[0])
    if wishes.minimise == "time" and len(every) > 1:
        yield from robust_optimal(goals, found, show)
        return
    # the robot as it is, or some for the band of payloads
    robots = [every[k] for k in spread(len(every), ROBOTS)]
    start = fitted(goals.given.once.joints, COARSE.splines, COARSE.degree)
    limits, area = reference_limits(goals, given), area_of(goals)
    show("optimal control", None)
    judge = Judge(goals, PAYLOADS[0])
    for _ in range(TRIES):
        last: Candidate | None = None
        for motion in optimal_motions(robots, limits, area, start, wishes.minimise, wishes.duration):
            show(f"optimal control: {motion.spline.duration:.4g} s, {motion.status}", None)
            if motion.converged and motion.grid != COARSE:
                last, start = candidate(goals, motion.spline, wishes.minimise), motion.spline
                yield last
        if last is None or not (excess := excesses(judge.assess(last))):
            return
        # what the FMU finds beyond the limits is taken off them
        torque, residual = (excess.get(name, 1.0) for name in ("torque", "residual"))
        robots = [replace(each, torque=each.torque / torque, residual=each.residual / residual) for each in robots]
        limits = limits.divided([excess.get(name, 1.0) for name in RATES])
        area = replace(area, margin=max(0.0, area.margin - excess.get("clearance", 0.0)))


def candidate(goals: Goals, spline: JointSpline, kind: str) -> Candidate:
    """A joint spline as a candidate."""
    label = f"optimal control, {kind}, {spline.duration:.4g} s"
    return Candidate(label, "optimal control", goals.scene, spline.trajectory())


def reference_limits(goals: Goals, given: Assessment) -> ReferenceLimits:
    """Limits of the joint references in numbers."""
    return ReferenceLimits(
        *(float(goals.limit(name, np.array(value))) for name, value in zip(RATES, given.references, strict=True))
    )


def robots_of(goals: Goals, given: Assessment) -> list[RobotLimits]:
    """The robots within the band of payloads, the lightest first, each with the torques that it may need."""
    return [
        RobotLimits(
            peaks.variation.of(goals.scene),
            goals.limit("torque", np.array(peaks.torque)),
            goals.wishes.residual,
        )
        for peaks in given.peaks
        if peaks.variation.stiffness == peaks.variation.damping == 1.0
    ]


def area_of(goals: Goals) -> Area:
    """Where the end effector may go: a rectangle along the crossing, less regions.

    What the given motion encloses is continued beyond the chord from start to end, so that the motion starts and ends at a side and
    not at a corner, where distances aren't smooth.
    """
    trace, clearance = goals.trace, goals.clearance
    across = (trace[-1] - trace[0]) / np.hypot(*(trace[-1] - trace[0]))
    up = np.array([-across[1], across[0]])
    stated = goals.wishes.keep_out is not None
    if not stated:
        up = clearance.normals[3]
    axes = np.stack([across, up])
    placed = ((trace if stated else clearance.origins) - trace[0]) @ axes.T
    low, high = placed.min(axis=0), placed.max(axis=0)
    if stated:
        room = SIDES * (high[0] - low[0])
        regions, low, high = clearance.regions, low - room, high + room
    else:
        deep = high[1] * up
        regions = (Polygon.of(np.vstack([trace, trace[-1] - deep, trace[0] - deep])),)
    return Area(trace[0], axes, low, high, tuple(map(_distances, regions)), RESERVE * goals.wishes.margin)


def _distances(region: Polygon) -> Callable[[RealArray], RealArray]:
    """A region's distances, computed for some points at a time."""

    def distances(points: RealArray) -> RealArray:
        parts = np.array_split(points, len(points) // CHUNK + 1)
        return np.concatenate([region.distance(part)[0] for part in parts])

    return distances
