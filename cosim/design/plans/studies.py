"""The study of a plan's goals: what a search may choose, the robots of the bands, and all limits in numbers."""

from __future__ import annotations

from math import inf

import numpy as np

from flexfmu.cosim.design.plans.assessment import INSTANTS
from flexfmu.cosim.design.plans.goals import RATES, Goals, peak_rates
from flexfmu.cosim.design.plans.motion_families import Space
from flexfmu.cosim.design.plans.quick_runs import JointMotion, QuickRobot
from flexfmu.cosim.design.plans.scoring import Bounds, Score
from flexfmu.cosim.design.plans.sequential_programme import MotionStudy
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import RestPositions, StaticEquilibria
from flexfmu.model.modes import damped_modes
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.trajectories.shapers.sequence import Oscillator

MOST_MODES, NEIGHBOURHOOD = 2, 3.0
"""Modes that shapers are designed for: at most so many, with frequencies up to this multiple of the lowest."""

PERIODS = 4.0
"""Standstill after a quick run, in periods of the lowest mode."""

LEAST_DWELL, MOST_DWELL = 0.03, 0.25
"""Limits of that [s]."""

CLOSE = {"torque": 0.998, "speed": 0.999, "acceleration": 0.998, "jerk": 0.96, "power": 0.998}
"""Part of a limit that quick runs allow, since they miss peaks between instants."""

LOWEST, HIGHEST = 0.6, 2.0
"""Range of the path's height, as multiples of the given one, where the given motion's way doesn't bound it."""


def study_of(goals: Goals, payloads: int, step: float) -> MotionStudy:
    """The study of goals.

    Args:
        goals: limits, bands and clearance.
        payloads: number of payloads within the band.
        step: longest communication step of its runs [s].

    Raises:
        InputError: the scene's motion is a table.
        BuildError, EquilibriumError, TrajectoryError: the robot can't be run, or its given motion.
    """
    scene, section = goals.scene, goals.scene.trajectory
    if not isinstance(section, TrajectorySection):
        raise InputError(f"scene {scene.name} has a motion from a table, and no path whose corners could change")
    given = loop_of(scene).motion.once
    variants = [each.changes(scene) for each in goals.variations(payloads)]
    # modes at the end of the motion
    found = damped_modes(scene, given.end_pose[0])
    pairs = zip(found.frequencies[:MOST_MODES], found.ratios[:MOST_MODES], strict=True)
    modes = [Oscillator(float(f), float(z)) for f, z in pairs if f <= NEIGHBOURHOOD * found.frequencies[0]]
    dwell = min(max(PERIODS / modes[0].frequency, LEAST_DWELL), MOST_DWELL) if modes else LEAST_DWELL
    # the robot, and its equilibria at the end
    path = build_scene(scene).path
    rests = RestPositions(given, StaticEquilibria(scene, path))
    rest = np.array([rests.at(each) for each in variants])
    dwell += goals.wishes.settled_within
    robot = QuickRobot(scene, path, variants, rest, min(step, given.duration / 50.0), dwell)
    # corners and heights
    low, high = LOWEST * section.height, HIGHEST * section.height
    if goals.wishes.keep_out is None:
        low, high = section.height, section.height + goals.wishes.corridor
    space = Space(tuple(modes), (low, high), section.width, given.duration, goals.wishes.duration)
    return MotionStudy(scene, space, robot, _bounds(goals, robot, given))


def _bounds(goals: Goals, robot: QuickRobot, given: MotionPlan) -> Bounds:
    """The limits in SI units, those relative to the given motion by its quick run."""
    times = np.linspace(0.0, given.duration, robot.steps(given.duration) + 1)
    run = robot.run(JointMotion(times, np.asarray(given.joints.evaluate(times, 2, "left"))))
    wishes, clearance = goals.wishes, goals.clearance
    free = Bounds(wishes.minimise, wishes.residual, wishes.settled_within, np.full_like(run.peak_torques, inf))
    usual = {**Score(run, free).values, **dict(zip(RATES, peak_rates(given.joints, INSTANTS).tolist(), strict=True))}
    limits = {
        name: CLOSE.get(name, 1.0) * float(limit.resolved(np.array(usual[name])))
        for name, limit in goals.limits.items()
        if name in usual and name != "torque"
    }
    # torques of each motor and robot
    largest = CLOSE["torque"] * goals.limit("torque", run.peak_torques, inf)
    bounded = bool(clearance.regions) or len(clearance.origins) > 0
    distance = clearance.distance if bounded else None
    return Bounds(
        wishes.minimise, wishes.residual, wishes.settled_within, largest, limits, distance, wishes.margin,
        clearance.passage if clearance.thin and bounded else None,
    )  # fmt: skip
