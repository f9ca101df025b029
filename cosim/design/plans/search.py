"""Searches corners, time laws, durations and shapers by runs of the FMU, each with all robots of the bands side by side.

First every combination of shapers is tried on one path, then the best of them with every time law and kind of corners, each with
the duration at which the limits hold. The best families then improve their numbers by linear programmes; after each round the worse
half is dropped. The result doesn't depend on the number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any

import numpy as np

from flexfmu.cosim.design.plans.assessment import Assessment, Candidate
from flexfmu.cosim.design.plans.designs import changed
from flexfmu.cosim.design.plans.goals import Goals
from flexfmu.cosim.design.plans.motion_families import BLENDS, LAWS, MotionFamily, motion_families, shaper_uses
from flexfmu.cosim.design.plans.scoring import CLEARANCE
from flexfmu.cosim.design.plans.sequential_programme import (
    RADIUS,
    FrontMember,
    Iterate,
    MotionStudy,
    MotionTrial,
    first_iterate,
    improved,
    merged,
)
from flexfmu.cosim.design.plans.studies import study_of
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.cosim.many.executor import mapping
from flexfmu.trajectories.jets import RealArray

Iterating = Callable[[Sequence[tuple[Any, ...]]], Iterator[Iterate]]
"""Functions and their further arguments → their iterates, in this order."""

QUICK, CONFIRMED = (7, 1e-3), (25, 5e-4)
"""Payloads of the band and communication step [s] of quick runs, and of those that confirm what is reported."""

FIRST = MotionFamily(BLENDS[0], next(iter(LAWS)), ())
"""Corners and time law with which shapers are compared."""

KEPT = 3
"""Combinations of shapers that are tried with all corners and time laws."""

SPREAD = 0.15
"""Standard deviation of a family's second start, in each number."""

ROUNDS = ((8, 4), (5, 6), (3, 8), (2, 10))
"""Number of families and of linear programmes in each round."""

RELAXED = ((3, 6), (1, 12))
"""The same for what would be possible without a limit."""

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


def search(goals: Goals, found: Sequence[Assessment], processes: int, show: ShowProgress) -> Iterator[Candidate]:
    """Yield ever better motions, then what would be possible without the clearance, then slower ones with less vibration.

    Args:
        goals: limits, bands and clearance.
        found: assessed before; plays no part.
        processes: number of processes; the motions don't depend on it.
        show: is called with what is being done, and the finished fraction.

    Raises:
        InputError: the scene's motion has no path.
        BuildError, EquilibriumError, TrajectoryError: the robot can't be run, or its given motion.
    """
    show("search: modes and limits", 0.0)
    study, judge = (study_of(goals, *each) for each in (QUICK, CONFIRMED))
    relaxable = (CLEARANCE,) if study.bounds.distance is not None else ()
    searching = MotionSearch(study, judge, goals.wishes.seed, processes, relaxable)
    for each in searching.found(lambda fraction, text: show(f"search: {text}", fraction)):
        without = "".join(f", without the {name}" for name in each.without)
        yield Candidate(f"{each.trial.design.label}{without}", "search", changed(goals.scene, each.trial.design))


@dataclass(frozen=True)
class Found:
    """A motion that a search found.

    Attributes:
        trial: the motion and its figures.
        without: names of the limits that it was allowed to exceed.
    """

    trial: MotionTrial
    without: tuple[str, ...] = ()


class MotionSearch:
    """A search, step by step.

    Args:
        study: what may be chosen, the limits, and the robot for quick runs.
        judge: the same with more variants and shorter steps, which confirms what is reported.
        seed: of the second starts.
        processes: number of processes.
        relaxable: names of limits without which the search is repeated.
    """

    def __init__(
        self, study: MotionStudy, judge: MotionStudy, seed: int = 0, processes: int = 1, relaxable: Sequence[str] = ()
    ) -> None:
        self._study, self._judge, self._processes = study, judge, processes
        self._random, self._relaxable = np.random.default_rng(seed), relaxable
        self._tighter: Mapping[str, float] = {}
        self._reported, self._within = inf, False

    def found(self, progress: Callable[[float, str], None] = lambda fraction, text: None) -> Iterator[Found]:
        """Yield ever better motions, then what would be possible without limits, then the rest of the front."""
        with mapping(partial(_iterate_of, self._study), self._processes) as iterating:
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
            for done, last in self._rounds(iterating, iterates, ROUNDS):
                progress(0.15 + 0.65 * done, "the best families")
                yield from self._confirmed(last)
            # without some limit
            for name in self._relaxable:
                progress(0.8, f"without the {name}")
                yield from self._relaxed(iterating, last, name)
            yield from self._front(merged([iterate.front for iterate in last]))
            progress(1.0, "done")

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

    def _rounds(
        self, iterating: Iterating, iterates: Sequence[Iterate], rounds: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[float, list[Iterate]]]:
        """Yield the finished fraction, and the iterates of each round after a few more steps."""
        total, passed, iterates = sum(count * steps for count, steps in rounds), 0, list(iterates)
        for count, steps in rounds:
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

    def _relaxed(self, iterating: Iterating, iterates: Sequence[Iterate], name: str) -> Iterator[Found]:
        """Yield the best motion that may exceed a limit, if it gains by that."""
        own = self._reported, self._within
        iterates = sorted(iterates, key=lambda iterate: iterate.cost)[:KEPT]
        free = [
            replace(iterate, tighter={**iterate.tighter, name: 0.0}, radius=RADIUS, front=()) for iterate in iterates
        ]
        chosen = list(dict.fromkeys(iterate.family for iterate in iterates))
        others = [
            replace(each, tighter={**each.tighter, name: 0.0}) for each in self._first_iterates(iterating, chosen)
        ]
        *_, (_, last) = self._rounds(iterating, [*free, *others], RELAXED)
        yield from self._confirmed(last)
        self._reported, self._within = own

    def _confirmed(self, iterates: Sequence[Iterate]) -> Iterator[Found]:
        """Yield the best motion if it is better than all before and the judge finds it within limits too."""
        iterate = min(iterates, key=lambda iterate: iterate.cost)
        if iterate.best is None or iterate.cost > self._reported - BETTER:
            return
        judged = self._judge.tried(iterate.best.design)
        if judged is None:
            return
        without = tuple(name for name, factor in iterate.tighter.items() if factor == 0.0)
        # between the variants and instants of the quick runs a limit may be exceeded
        exceeded = {
            name: judged.score.uses[name] / use
            for name, use in iterate.best.score.uses.items()
            if name != CLEARANCE and iterate.tighter.get(name, 1.0) and use <= 1.0 < judged.score.uses[name]
        }
        if exceeded:
            further = {name: min(SAFETY * ratio, WIDEST) for name, ratio in exceeded.items()}
            self._tighter = {**self._tighter, **further}
            return
        # until limits hold, what exceeds them least
        within = set(judged.score.exceeded) <= set(without)
        if within or not self._within:
            self._reported, self._within = iterate.cost, self._within or within
            yield Found(judged, without)

    def _front(self, front: Sequence[FrontMember]) -> Iterator[Found]:
        """Yield slower motions with less residual vibration."""
        feasible = [each for each in front if each.figures.feasible]
        fastest = min((each.figures.values["time"] for each in feasible), default=0.0)
        reported = set[int]()
        for stretch in STRETCHES:
            within = [each for each in feasible if each.figures.values["time"] <= stretch * fastest]
            best = min(within, key=lambda each: each.figures.values["residual"], default=None)
            if best is None or id(best) in reported:
                continue
            reported.add(id(best))
            judged = self._judge.tried(best.design)
            if judged is not None and judged.score.feasible:
                yield Found(judged)


def _cost_without_clearance(iterate: Iterate) -> float:
    """Cost of an iterate but for the clearance, which depends on corners rather than on shapers."""
    return inf if iterate.best is None else iterate.best.score.cost({**iterate.tighter, CLEARANCE: 0.0})


def _iterate_of(study: MotionStudy, task: tuple[Any, ...]) -> Iterate:
    """The iterate that a function makes of a study and further arguments."""
    function, *arguments = task
    found: Iterate = function(study, *arguments)
    return found
