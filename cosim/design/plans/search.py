"""Searches corners, time laws, durations and shapers within limits that hold for all robots of the bands.

Every combination of shapers is improved a little for few robots on short grids, by the programmes of optimal control with the numbers of
a motion family as variables; the best families go on, also with other corners and from a second start. The best motion is then
improved for all robots until the FMU finds its limits kept. The result doesn't depend on the number of processes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import log
from typing import Any

import numpy as np

from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.designs import INTERVALS, LAW, LONGEST, FamilyMotion, ShaperChoice, first_numbers
from flexfmu.cosim.design.plans.goals import Goals, Variation
from flexfmu.cosim.design.plans.optimal import limited, nodes_of, refined, robots_of
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.cosim.many.executor import mapping
from flexfmu.model.reference_design.optimal_control import Aim, Stage, State, Way
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.statics import damped_modes
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.shapers.sequence import Oscillator

SINGLE = ("zv", "zvd", "ei", "zvdd", "2-hump-ei")
"""Shapers for the lowest mode."""

PAIRS = (("zv", "zv"), ("zvd", "zv"), ("zv", "zvd"), ("zvd", "zvd"), ("ei", "ei"), ("zvdd", "zvd"))
"""Shapers for the two lowest modes."""

CORNERS = ("lame", "polar")
"""Kinds of corners; combinations of shapers are compared with the first one. Clothoids and other time laws than polynomials with as many
numbers win on no robot that was tried."""

ROUNDS, FINAL = ((3, 1, 5), (5, 2, 8), (7, 2, 10)), (7, 4, 10)
"""Payloads, steps of the integration in each part of a motion, and programmes of each round, and of motions that are judged."""

KEPT, LAST = 3, 2
"""Families that go on after the first round, and after the second one."""

SPREAD = 0.15
"""Standard deviation of a family's second start, in each number but those of the time law."""

STRETCH, STRETCHES, DEARER = 1.4, 5, 10.0
"""Factor by which a first motion is slower where there is none, or none that meets limits in the end, how often, and that on the price
of what isn't met."""

QUIETER = 0.95
"""Factor on the limit of the residual vibration in each further try of a motion that is judged."""

NEARLY, INFEASIBLE = 0.01, 10.0
"""Violation up to which limits count as met, half as much again of the residual vibration, and what others cost more."""

WORTH = 2.0
"""Weight of the violations of limits beside the logarithm of what is minimised."""

MOST_MODES, NEIGHBOURHOOD = 2, 3.0
"""Modes that shapers are designed for: at most so many, with frequencies up to this multiple of the lowest."""

LOWEST, HIGHEST = 0.6, 2.0
"""Range of the path's height, as multiples of the given one, where the given motion's way doesn't bound it."""

PATHS = ((0.7, 0.8, 0.5), (1.0, 1.0, 0.1), (0.2, 0.8, 0.5))
"""Lift, height and width of the corners to begin with, as points of the unit cube: usual ones, and what goes around walls."""

QUIET, SLOWER = (0.1,), 1.2
"""Residual vibration of the front's slower motion, relative to the limit, and the factor on the duration of their first motions."""

NONE = 1e-2
"""Limit of the residual vibration, relative to the wish, where it is what is minimised."""

Found = tuple[list[float], float, float] | None
"""What a journal has of a family's motion: its numbers, duration and cost."""

Ranked = tuple[float, int, FamilyMotion]
"""A motion with its cost and its place among others."""


def search(judge: Judge, found: Sequence[Assessment], processes: int, show: ShowProgress) -> Iterator[Candidate | str]:
    """Yield ever better motions, then slower ones with less vibration.

    Args:
        judge: knows limits, bands and clearance.
        found: the given motion, and what else was assessed.
        processes: number of processes; the motions don't depend on it.
        show: is called with what is being done, and the finished fraction.

    Raises:
        InputError: the scene's motion has no path.
        BuildError, EquilibriumError, TrajectoryError: the robot can't be run, or its given motion.
    """
    show("search: modes and limits", 0.0)
    goals, journal, study = judge.goals, judge.journal, study_of(judge.goals, found[0])
    going, best, random = [*study.first], list[FamilyMotion](), np.random.default_rng(goals.wishes.seed)
    with mapping(partial(_improved, study), processes) as work:
        for number, effort in enumerate(ROUNDS):
            keys = [("search", number, k) for k in range(len(going))]
            pairs = zip(keys, going, strict=True)
            made, ranked = work([(each, *effort, False) for key, each in pairs if key not in journal]), list[Ranked]()
            for k, (key, motion) in enumerate(zip(keys, going, strict=True)):
                kept = journal.kept(key, Found, partial(next, made))
                if kept is not None:
                    ranked.append((kept[2], k, _as_found(motion, kept)))
                done = number + (k + 1) / len(going)
                show(f"search: round {number + 1} of {len(ROUNDS)}", done / (len(ROUNDS) + 1))
            best = [motion for _, _, motion in sorted(ranked)]
            going = best[:LAST]
            if number == 0 and best:
                # with the other corners, and from a start whose path and frequencies differ a little
                others = [replace(each, blend=CORNERS[1]) for each in best[:LAST]]
                spread = SPREAD * random.standard_normal(len(best[0].numbers))
                spread[LAW] = 0.0
                going = [*best[:KEPT], *others, best[0].moved(np.append(spread, 0.0))]
    if not best:
        raise TrajectoryError(f"scene {goals.scene.name}: no motion of the search can be planned")
    yield from _judged(judge, study, best[0], show)


def _as_found(motion: FamilyMotion, found: tuple[list[float], float, float]) -> FamilyMotion:
    """A motion with what a journal has of it."""
    return replace(motion, numbers=np.array(found[0]), duration=found[1])


def _judged(judge: Judge, study: MotionStudy, first: FamilyMotion, show: ShowProgress) -> Iterator[Candidate | str]:
    """A motion improved for more robots until the FMU finds its limits kept, then slower ones with less vibration."""
    last, goals = first, judge.goals

    def attempt(
        key: tuple[str, Any], ways: Sequence[Way], loads: Mapping[str, RealArray], loose: float
    ) -> tuple[list[FamilyMotion], bool] | None:
        nonlocal last
        (way,), (place, number) = ways, key
        start, again = way.start, place == "judged"
        assert isinstance(start, FamilyMotion)
        # between the payloads of the programmes residuals are larger, whether or not the limit binds at them
        further = QUIETER**number if again else 1.0
        limits = replace(way.limits, residual=further * way.limits.residual)
        tight = replace(study, way=replace(way, limits=limits), loads=loads)
        found = judge.journal.kept(("search", *key), Found, lambda: _improved(tight, (start, *FINAL, again)))
        if found is None:
            return None
        last = _as_found(first, found)
        show(f"search: {last.duration:.4g} s", None)
        return [last], True

    way, made = replace(study.way, start=first), lambda motions: candidate_of(goals, motions[0])
    yield from refined(judge, attempt, made, [way], study.loads, 0.0, ("judged",))
    for share in QUIET if goals.wishes.duration is None else ():
        limits = study.way.limits.tightened({"residual": 1.0 / share})
        way = replace(way, start=last.with_duration(SLOWER * last.duration), limits=limits)
        if (tried := attempt(("quiet", share), [way], study.loads, 0.0)) is not None:
            yield candidate_of(goals, tried[0][0])


def candidate_of(goals: Goals, motion: FamilyMotion) -> Candidate:
    """A motion of the search as a candidate."""
    return Candidate(motion.label, "search", goals.scene.replace(motion.changes))


@dataclass(frozen=True)
class MotionStudy:
    """What the search of a scene needs.

    Attributes:
        first: motions with all combinations of shapers and the first kind of corners.
        variations: the robots.
        way: limits and robots, and the given motion.
        loads: limits of RMS torque and energy.
        aim: what is minimised.
    """

    first: tuple[FamilyMotion, ...]
    variations: tuple[Variation, ...]
    way: Way
    loads: Mapping[str, RealArray]
    aim: Aim


def study_of(goals: Goals, given: Assessment, payloads: int = FINAL[0]) -> MotionStudy:
    """The study of goals.

    Args:
        goals: limits, bands and clearance.
        given: the given motion.
        payloads: number of payloads within the band.

    Raises:
        InputError: the scene's motion is a table.
        BuildError, EquilibriumError, TrajectoryError: the robot can't be run, or its given motion.
    """
    scene, section, wishes = goals.scene, goals.scene.trajectory, goals.wishes
    if not isinstance(section, TrajectorySection):
        raise InputError(f"scene {scene.name} has a motion from a table, and no path whose corners could change")
    variations = goals.variations(payloads)
    (way,), loads = limited(goals, given, [(robots_of(scene, variations), np.arange(len(variations)))], walls=True)
    if wishes.minimise == "residual":
        way = replace(way, limits=replace(way.limits, residual=NONE * way.limits.residual))
    # modes at the end of the motion
    found = damped_modes(scene, goals.given.once.end_pose[0])
    pairs = zip(found.frequencies[:MOST_MODES], found.ratios[:MOST_MODES], strict=True)
    modes = [Oscillator(float(f), float(z)) for f, z in pairs if f <= NEIGHBOURHOOD * found.frequencies[0]]
    shapers: list[tuple[ShaperChoice, ...]] = [(), *(((kind, modes[0]),) for kind in SINGLE if modes)]
    if len(modes) > 1:
        shapers += [((a, modes[0]), (b, modes[1])) for a, b in PAIRS]
    # heights
    heights = LOWEST * section.height, HIGHEST * section.height
    if wishes.keep_out is None:
        heights = section.height, section.height + wishes.corridor
    usual = wishes.duration or goals.given.once.duration
    unshaped = FamilyMotion(
        scene.mechanism, section, heights, CORNERS[0], (), np.zeros(0), usual, max(INTERVALS, round(usual / LONGEST))
    )
    # the path that has least to go around
    starts = [replace(unshaped, numbers=first_numbers(path, 0)) for path in PATHS]
    path = PATHS[int(np.argmin([goals.clearance.passage(each.points) for each in starts]))]
    first = (replace(unshaped, shapers=each, numbers=first_numbers(path, len(each))) for each in shapers)
    return MotionStudy(tuple(first), variations, way, loads, wishes.minimise)


def _improved(study: MotionStudy, task: tuple[FamilyMotion, int, int, int, bool]) -> Found:
    """A motion after some programmes for some robots, with its cost; None if there is none of this family.

    The task is the first motion, numbers of payloads, steps and programmes, and whether what misses limits is tried again.
    """
    motion, robots, parts, programmes, again = task
    cases = np.array(nodes_of(study.variations, robots))
    loads, found = {name: each[cases] for name, each in study.loads.items()}, list[tuple[float, FamilyMotion]]()
    for number in range(STRETCHES):
        try:
            stage = Stage(
                [replace(study.way, start=motion).of_cases(cases)], loads, parts, [study.first[0].duration], study.aim
            )
            # where limits weren't met before they are worth more
            stage.price *= DEARER ** min(len(found), number)
            *_, state = stage.improvements((motion,), programmes)
            (motion,), missed = state.motions, state.violations  # type: ignore[assignment]
            cost = log(max(_minimised(study.aim, state), 1e-12)) + WORTH * float(missed.sum())
            found.append((cost + (INFEASIBLE if missed.max() > NEARLY else 0.0), motion))
            if missed.max() < NEARLY or not again:
                break
        except (TrajectoryError, EquilibriumError):
            pass
        if study.aim != "time":
            break
        motion = motion.with_duration(STRETCH * motion.duration)
    if not found:
        return None
    cost, motion = min(found, key=lambda each: each[0])
    return motion.numbers.tolist(), motion.duration, cost


def _minimised(aim: Aim, state: State) -> float:
    """What is minimised, in its own unit or its square, for a motion alone."""
    if aim == "time":
        return state.motions[0].duration
    if aim == "residual":
        return float(np.linalg.norm(state.amplitudes[0], axis=1).sum(axis=-1).max())
    return float(state.ways[0].loads.need(aim).max())
