"""Searches corners, time laws, durations and shapers by runs of the FMU, each with all robots of the bands side by side.

First every combination of shapers is tried on one path, then the best of them with every time law and kind of corners, each with
the duration at which the limits hold. The best families then improve their numbers by linear programmes; after each round the worse
half is dropped. The result doesn't depend on the number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from typing import Any

import numpy as np

from flexfmu.cosim.design.plans.assessment import INSTANTS, Assessment, Candidate
from flexfmu.cosim.design.plans.designs import CORNERS, LAWS, Design, MotionFamily, Space, motion_families, shaper_uses
from flexfmu.cosim.design.plans.goals import RATES, Goals, peak_rates
from flexfmu.cosim.design.plans.quick_runs import CLEARANCE, Bounds, JointMotion, QuickRobot, Score
from flexfmu.cosim.design.plans.sequential_programme import (
    FrontMember,
    Iterate,
    MotionStudy,
    MotionTrial,
    first_iterate,
    improved,
)
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import RestPositions
from flexfmu.cosim.many.executor import mapping
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.statics import damped_modes
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.shapers.sequence import Oscillator

Iterating = Callable[[Sequence[tuple[Any, ...]]], Iterator[Iterate]]
"""Functions and their further arguments → their iterates, in this order."""

QUICK, CONFIRMED = (7, 1e-3), (25, 5e-4)
"""Payloads of the band and communication step [s] of quick runs, and of those that confirm what is reported."""

FIRST = MotionFamily(CORNERS[0], next(iter(LAWS)), ())
"""Corners and time law with which shapers are compared."""

KEPT = 3
"""Combinations of shapers that are tried with all corners and time laws."""

SPREAD = 0.15
"""Standard deviation of a family's second start, in each number."""

ROUNDS = ((8, 4), (5, 6), (3, 8), (2, 10))
"""Number of families and of linear programmes in each round."""

PIECE = 2
"""Linear programmes in a task of a process: after it the search can be interrupted."""

BETTER = 3e-3
"""Least relative improvement that is reported."""

SAFETY = 1.005
"""Factor of what a limit is exceeded by between the variants and instants of the quick runs."""

WIDEST = 1.5
"""Largest factor by which limits become tighter for that."""

STRETCHES = (1.05, 1.1, 1.2, 1.35, 1.5)
"""Times of the front's other members, as multiples of the best."""

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


Kept = tuple[MotionFamily, list[float], Design | None, float, tuple[FrontMember, ...], dict[str, float]]
"""What a journal has of an iterate: its best motion by its design."""


def search(
    goals: Goals, found: Sequence[Assessment], processes: int, show: ShowProgress, journal: WorkJournal = NOWHERE
) -> Iterator[Candidate]:
    """Yield ever better motions, then slower ones with less vibration.

    Args:
        goals: limits, bands and clearance.
        found: assessed before; plays no part.
        processes: number of processes; the motions don't depend on it.
        show: is called with what is being done, and the finished fraction.
        journal: where iterates are kept.

    Raises:
        InputError: the scene's motion has no path.
        BuildError, EquilibriumError, TrajectoryError: the robot can't be run, or its given motion.
    """
    show("search: modes and limits", 0.0)
    study, judge = (study_of(goals, *each) for each in (QUICK, CONFIRMED))
    motions = MotionSearch(study, judge, goals.wishes.seed, processes, journal)
    for each in motions.found(lambda fraction, text: show(f"search: {text}", fraction)):
        yield Candidate(each.design.label, "search", goals.scene.replace(each.design.changes))


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
    rests = RestPositions(given, path)
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
    pause = goals.scene.trajectory.dwell
    free = Bounds(
        wishes.minimise, wishes.residual, wishes.settled_within, np.full_like(run.peak_torques, inf), pause=pause
    )
    usual = {**Score(run, free).loads, **dict(zip(RATES, peak_rates(given.joints, INSTANTS), strict=True))}
    limits = {
        name: CLOSE.get(name, 1.0) * limit.resolved(usual[name])
        for name, limit in goals.limits.items()
        if name in usual and name != "torque"
    }
    # torques of each motor and robot
    largest = CLOSE["torque"] * goals.limit("torque", run.peak_torques, inf)
    bounded = bool(clearance.regions) or len(clearance.origins) > 0
    distance = clearance.distance if bounded else None
    return Bounds(
        wishes.minimise, wishes.residual, wishes.settled_within, largest, limits, distance, wishes.margin,
        pause, clearance.passage if clearance.thin and bounded else None,
    )  # fmt: skip


class MotionSearch:
    """A search, step by step.

    Args:
        study: what may be chosen, the limits, and the robot for quick runs.
        judge: the same with more variants and shorter steps, which confirms what is reported.
        seed: of the second starts.
        processes: number of processes.
        journal: where iterates are kept.
    """

    def __init__(
        self, study: MotionStudy, judge: MotionStudy, seed: int = 0, processes: int = 1, journal: WorkJournal = NOWHERE
    ) -> None:
        self._study, self._judge, self._processes = study, judge, processes
        self._journal, self._asked = journal, 0
        self._random = np.random.default_rng(seed)
        self._tighter: Mapping[str, float] = {}
        self._reported, self._within = inf, False

    def found(self, progress: Callable[[float, str], None] = lambda fraction, text: None) -> Iterator[MotionTrial]:
        """Yield ever better motions, then the rest of the front."""
        with mapping(partial(_iterate_of, self._study), self._processes) as work:
            iterating = partial(self._kept, work)
            # shapers first, then corners and time laws
            iterates, starts = list[Iterate](), shaper_uses(len(self._study.space.modes))
            for iterate in self._first_iterates(iterating, [replace(FIRST, shapers=uses) for uses in starts]):
                iterates.append(iterate)
                progress(0.05 * len(iterates) / len(starts), "shapers")
                yield from self._confirmed([iterate])
            best = [each.family.shapers for each in sorted(iterates, key=_cost_without_clearance)[:KEPT]]
            progress(0.05, "corners and time laws")
            iterates += self._first_iterates(iterating, motion_families(best))
            iterates += self._first_iterates(iterating, motion_families(best, [FIRST.law]), near=True)
            yield from self._confirmed(iterates)
            # the best families
            last = iterates
            for done, last in self._rounds(iterating, iterates):
                progress(0.15 + 0.85 * done, "the best families")
                yield from self._confirmed(last)
            yield from self._front([member for iterate in last for member in iterate.front])

    def _kept(self, work: Iterating, tasks: Sequence[tuple[Any, ...]]) -> Iterator[Iterate]:
        """Iterates in the order of their tasks, which is always the same: those of the journal, and the others once they are made."""
        keys = [("search", self._asked + k) for k in range(len(tasks))]
        self._asked += len(tasks)
        made = work([task for key, task in zip(keys, tasks, strict=True) if key not in self._journal])
        for key in keys:
            if key in self._journal:
                found: Kept = self._journal.kept(key, Kept, _never)
                family, point, design, radius, front, tighter = found
                best = None if design is None else self._study.tried(design)
                yield Iterate(family, np.array(point), best, radius, front, tighter)
                continue
            iterate = next(made)
            self._journal.kept(key, Kept, partial(_data, iterate))
            yield iterate

    def _first_iterates(
        self, iterating: Iterating, chosen: Sequence[MotionFamily], *, near: bool = False
    ) -> Iterator[Iterate]:
        """Iterates of families at their usual numbers, or near them."""
        starts = [(each, self._study.space.start(each)) for each in chosen]
        return iterating(
            [(first_iterate, family, self._near(start) if near else start, self._tighter) for family, start in starts]
        )

    def _near(self, start: RealArray) -> RealArray:
        return np.asarray(np.clip(start + SPREAD * self._random.standard_normal(len(start)), 0.0, 1.0))

    def _rounds(self, iterating: Iterating, iterates: list[Iterate]) -> Iterator[tuple[float, list[Iterate]]]:
        """Yield the finished fraction, and the iterates of each round after a few more steps."""
        total, passed = sum(count * steps for count, steps in ROUNDS), 0
        for count, steps in ROUNDS:
            for first in range(0, steps, PIECE):
                # the best that aren't over; those that are make room for others
                length = min(PIECE, steps - first)
                iterates = [replace(iterate, tighter={**iterate.tighter, **self._tighter}) for iterate in iterates]
                able = [k for k, iterate in enumerate(iterates) if not iterate.over]
                going = sorted(able, key=[iterate.cost for iterate in iterates].__getitem__)[:count]
                for k, iterate in zip(going, iterating([(improved, iterates[k], length) for k in going]), strict=True):
                    iterates[k] = iterate
                passed += count * length
                yield passed / total, iterates

    def _confirmed(self, iterates: Sequence[Iterate]) -> Iterator[MotionTrial]:
        """Yield the best motion if it is better than all before and the judge finds it within limits too."""
        iterate = min(iterates, key=lambda iterate: iterate.cost)
        if iterate.best is None or iterate.cost > self._reported - BETTER:
            return
        judged = self._judge.tried(iterate.best.design)
        if judged is None:
            return
        # between the variants and instants of the quick runs a limit may be exceeded
        exceeded = {
            name: judged.score.uses[name] / use
            for name, use in iterate.best.score.uses.items()
            if name != CLEARANCE and use <= 1.0 < judged.score.uses[name]
        }
        if exceeded:
            further = {name: min(SAFETY * ratio, WIDEST) for name, ratio in exceeded.items()}
            self._tighter = {**self._tighter, **further}
            return
        # until limits hold, what exceeds them least
        if judged.score.feasible or not self._within:
            self._reported, self._within = iterate.cost, self._within or judged.score.feasible
            yield judged

    def _front(self, front: Sequence[FrontMember]) -> Iterator[MotionTrial]:
        """Yield slower motions with less residual vibration."""
        fastest = min((time for time, _, _ in front), default=0.0)
        within = [[each for each in front if each[0] <= stretch * fastest] for stretch in STRETCHES]
        for design in dict.fromkeys(min(each, key=lambda member: member[1])[2] for each in within if each):
            judged = self._judge.tried(design)
            if judged is not None and judged.score.feasible:
                yield judged


def _never() -> Kept:
    raise AssertionError  # only what is in the journal is asked for


def _data(iterate: Iterate) -> tuple[Any, ...]:
    best = None if iterate.best is None else iterate.best.design
    return iterate.family, iterate.point, best, iterate.radius, iterate.front, iterate.tighter


def _cost_without_clearance(iterate: Iterate) -> float:
    """Cost of an iterate but for the clearance, which depends on corners rather than on shapers."""
    return inf if iterate.best is None else iterate.best.score.cost({**iterate.tighter, CLEARANCE: 0.0})


def _iterate_of(study: MotionStudy, task: tuple[Any, ...]) -> Iterate:
    """The iterate that a function makes of a study and further arguments."""
    function, *arguments = task
    found: Iterate = function(study, *arguments)
    return found
