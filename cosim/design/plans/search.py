"""Searches corners, time laws, durations and shapers within limits that hold for all robots of the bands.

Every combination of shapers is improved a little for few robots on short grids, by the programmes of optimal control with the numbers of
a motion family as variables; the best families go on, also with other corners and from a second start. The best motion is then
improved for all robots until the FMU finds its limits kept. The result doesn't depend on the number of processes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, log
from typing import Any

import numpy as np

from flexfmu.cosim.control.blocks.code import CompiledAtPoints
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.designs import PATHS, Design, FamilyMotion, MotionFamily
from flexfmu.cosim.design.plans.goals import Goals
from flexfmu.cosim.design.plans.optimal import limited, refined
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.cosim.many.executor import mapping
from flexfmu.model.reference_design.elastic_response import RobotVariant
from flexfmu.model.reference_design.optimal_control import Aim, Stage, State, Way, spread
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

QUIET, SLOWER = (0.1,), 1.2
"""Residual vibration of the front's slower motion, relative to the limit, and the factor on the duration of their first motions."""

NONE = 1e-2
"""Limit of the residual vibration, relative to the wish, where it is what is minimised."""

Found = tuple[list[float], float, float] | None
"""What a journal has of a family's motion: its numbers, duration and cost."""


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
    best, asked, fraction = list[FamilyMotion](), 0, 0.0
    random = np.random.default_rng(goals.wishes.seed)
    with mapping(partial(_improved, study), processes) as work:
        going = [*study.first]
        for number, (robots, parts, programmes) in enumerate(ROUNDS):
            tasks = [(each, robots, parts, programmes, False) for each in going]
            keys = [("search", asked + k) for k in range(len(tasks))]
            made = work([task for key, task in zip(keys, tasks, strict=True) if key not in journal])
            asked, costs = asked + len(tasks), list[float]()
            for k, (key, motion) in enumerate(zip(keys, going, strict=True)):
                kept = journal.kept(key, Found, lambda made=made: next(made))  # type: ignore[misc]
                costs.append(inf if kept is None else kept[2])
                if kept is not None:
                    going[k] = replace(motion, numbers=np.array(kept[0]), duration=kept[1])
                show(f"search: round {number + 1} of {len(ROUNDS)}", fraction + 0.25 * (k + 1) / len(going))
            fraction += 0.25
            order = [int(k) for k in np.argsort(costs, kind="stable") if costs[k] < inf]
            best = [going[k] for k in order]
            if number == 0:
                # with the other corners
                other = [replace(each, family=replace(each.family, blend=CORNERS[1])) for each in best[:LAST]]
                going = best[:KEPT] + other
                going += [study.near(each, random) for each in best[:1]]
            else:
                going = best[:LAST]
    if not best:
        raise TrajectoryError(f"scene {goals.scene.name}: no motion of the search can be planned")
    yield from _judged(judge, study, best[0], show)


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
        last = replace(first, numbers=np.array(found[0]), duration=found[1])
        show(f"search: {last.duration:.4g} s", None)
        return [last], True

    def made(motions: Sequence[FamilyMotion]) -> Candidate:
        return candidate_of(goals, motions[0].design)

    way = replace(study.way, start=first)
    yield from refined(judge, attempt, made, [way], study.loads, 0.0, ("judged",))
    for share in QUIET if goals.wishes.duration is None else ():
        start = last.with_duration(SLOWER * last.duration)
        way = replace(way, start=start, limits=study.way.limits.tightened({"residual": 1.0 / share}))
        if (tried := attempt(("quiet", share), [way], study.loads, 0.0)) is not None:
            yield made(tried[0])


def candidate_of(goals: Goals, design: Design) -> Candidate:
    """A design as a candidate."""
    return Candidate(design.label, "search", goals.scene.replace(design.changes))


@dataclass(frozen=True)
class MotionStudy:
    """What the search of a scene needs.

    Attributes:
        first: motions with all combinations of shapers and the first kind of corners.
        way: limits and robots, and the given motion.
        loads: limits of RMS torque and energy.
        aim: what is minimised.
        usual: duration of first motions [s].
    """

    first: tuple[FamilyMotion, ...]
    way: Way
    loads: Mapping[str, RealArray]
    aim: Aim
    usual: float

    def cases(self, count: int) -> list[int]:
        """Indices of robots: so many payloads, and all with other stiffness or damping."""
        payloads = sum(set(each.changes) <= {"payload.mass"} for each in self.way.robots)
        return [*spread(payloads, min(count, payloads)), *range(payloads, len(self.way.robots))]

    def near(self, motion: FamilyMotion, random: np.random.Generator) -> FamilyMotion:
        """A motion whose path and frequencies differ a little."""
        numbers = motion.numbers + SPREAD * random.standard_normal(len(motion.numbers)) * motion.family.are_free
        return replace(motion, numbers=np.clip(numbers, 0.0, 1.0))


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
    scene, section = goals.scene, goals.scene.trajectory
    if not isinstance(section, TrajectorySection):
        raise InputError(f"scene {scene.name} has a motion from a table, and no path whose corners could change")
    robots = [RobotVariant(scene, each.changes(scene), CompiledAtPoints) for each in goals.variations(payloads)]
    (way,), loads = limited(goals, given, [(robots, np.arange(len(robots)))], walls=True)
    wishes, usual = goals.wishes, goals.wishes.duration or goals.given.once.duration
    if wishes.minimise == "residual":
        way = replace(way, limits=replace(way.limits, residual=NONE * way.limits.residual))
    # modes at the end of the motion
    found = damped_modes(scene, goals.given.once.end_pose[0])
    pairs = zip(found.frequencies[:MOST_MODES], found.ratios[:MOST_MODES], strict=True)
    modes = [Oscillator(float(f), float(z)) for f, z in pairs if f <= NEIGHBOURHOOD * found.frequencies[0]]
    shapers: list[tuple[tuple[str, Oscillator], ...]] = [(), *(((kind, modes[0]),) for kind in SINGLE if modes)]
    if len(modes) > 1:
        shapers += [((a, modes[0]), (b, modes[1])) for a, b in PAIRS]
    # heights
    heights = LOWEST * section.height, HIGHEST * section.height
    if wishes.keep_out is None:
        heights = section.height, section.height + wishes.corridor
    families = [MotionFamily(scene, heights, CORNERS[0], each) for each in shapers]
    # the path that has least to go around
    starts = [families[0].start(path) for path in PATHS]
    best = PATHS[int(np.argmin([goals.clearance.passage(families[0].path(each)) for each in starts]))]
    first = tuple(FamilyMotion(each, each.start(best), usual, usual) for each in families)
    return MotionStudy(first, way, loads, wishes.minimise, usual)


def _improved(study: MotionStudy, task: tuple[FamilyMotion, int, int, int, bool]) -> Found:
    """A motion after some programmes for some robots, with its cost; None if there is none of this family.

    The task is the first motion, numbers of payloads, steps and programmes, and whether what misses limits is tried again.
    """
    motion, robots, parts, programmes, again = task
    cases = np.array(study.cases(robots))
    loads, found = {name: each[cases] for name, each in study.loads.items()}, list[tuple[float, FamilyMotion]]()
    for number in range(STRETCHES):
        try:
            stage = Stage([replace(study.way, start=motion).of_cases(cases)], loads, parts, [study.usual], study.aim)
            # where limits weren't met before they are worth more
            stage.price *= DEARER ** min(len(found), number)
            *_, state = stage.improvements((motion,), programmes)
            (motion,), missed = state.motions, state.violations  # type: ignore[assignment]
            cost = log(max(_minimised(study.aim, stage, state), 1e-12)) + WORTH * float(missed.sum())
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


def _minimised(aim: Aim, stage: Stage, state: State) -> float:
    """What is minimised, in its own unit or its square, for a motion alone."""
    if aim == "time":
        return state.motions[0].duration
    if aim == "residual":
        return float(np.linalg.norm(state.amplitudes[0], axis=1).sum(axis=-1).max())
    name = "square_torque" if aim == "rms_torque" else aim
    return float(np.abs(stage.ways[0].motors.values([name], state.motions[0], state.responses[0])[name]).max())
