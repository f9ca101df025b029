"""Searches corners, time laws, durations and shapers by runs of the FMU, each with all robots of the bands side by side.

First every combination of shapers is tried on one path, then the best of them with every time law and kind of corners, each with
the duration at which the limits hold. The best recipes then improve their numbers by linear programmes; after each round the worse
half is dropped. The result doesn't depend on the number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any

import numpy as np

from flexfmu.cosim.design.effects.choice import ShowProgress
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate
from flexfmu.cosim.design.plans.designs import changed
from flexfmu.cosim.design.plans.goals import Goals
from flexfmu.cosim.design.plans.race import RADIUS, Member, Race, Study, Trial, begun, improved, merged
from flexfmu.cosim.design.plans.recipes import BLENDS, LAWS, Recipe, recipes, shaper_uses
from flexfmu.cosim.design.plans.scoring import CLEARANCE
from flexfmu.cosim.design.plans.studies import study_of
from flexfmu.cosim.many.executor import mapping
from flexfmu.trajectories.jets import RealArray

Raced = Callable[[Sequence[tuple[Any, ...]]], Iterator[Race]]
"""Functions and their further arguments → their races, in this order."""

QUICK, CONFIRMED = (7, 1e-3), (25, 5e-4)
"""Payloads of the band and communication step [s] of quick runs, and of those that confirm what is reported."""

FIRST = Recipe(BLENDS[0], next(iter(LAWS)), ())
"""Corners and time law with which shapers are compared."""

KEPT = 3
"""Combinations of shapers that are tried with all corners and time laws."""

SPREAD = 0.15
"""Standard deviation of a recipe's second start, in each number."""

ROUNDS = ((8, 4), (5, 6), (3, 8), (2, 10))
"""Number of recipes and of linear programmes in each round."""

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
    races = Search(study, judge, goals.wishes.seed, processes, relaxable)
    for each in races.found(lambda fraction, text: show(f"search: {text}", fraction)):
        without = "".join(f", without the {name}" for name in each.without)
        yield Candidate(f"{each.trial.design.label}{without}", "search", changed(goals.scene, each.trial.design))


@dataclass(frozen=True)
class Found:
    """A motion that a search found.

    Attributes:
        trial: the motion and its figures.
        without: names of the limits that it was allowed to exceed.
    """

    trial: Trial
    without: tuple[str, ...] = ()


class Search:
    """A search, step by step.

    Args:
        study: what may be chosen, the limits, and the robot for quick runs.
        judge: the same with more variants and shorter steps, which confirms what is reported.
        seed: of the second starts.
        processes: number of processes.
        relaxable: names of limits without which the search is repeated.
    """

    def __init__(
        self, study: Study, judge: Study, seed: int = 0, processes: int = 1, relaxable: Sequence[str] = ()
    ) -> None:
        self._study, self._judge, self._processes = study, judge, processes
        self._random, self._relaxable = np.random.default_rng(seed), relaxable
        self._tighter: Mapping[str, float] = {}
        self._reported, self._within = inf, False

    def found(self, progress: Callable[[float, str], None] = lambda fraction, text: None) -> Iterator[Found]:
        """Yield ever better motions, then what would be possible without limits, then the rest of the front."""
        with mapping(partial(_raced, self._study), self._processes) as raced:
            # shapers first, then corners and time laws
            races, starts = list[Race](), shaper_uses(len(self._study.space.modes))
            for race in self._begun(raced, [replace(FIRST, shapers=uses) for uses in starts]):
                races.append(race)
                progress(0.05 * len(races) / len(starts), "shapers")
                yield from self._confirmed([race])
            best = [each.recipe.shapers for each in sorted(races, key=_without_clearance)[:KEPT]]
            progress(0.05, "corners and time laws")
            races += self._begun(raced, recipes(best))
            races += self._begun(raced, recipes(best, [FIRST.law]), near=True)
            yield from self._confirmed(races)
            # the best recipes
            last = races
            for done, last in self._rounds(raced, races, ROUNDS):
                progress(0.15 + 0.65 * done, "the best recipes")
                yield from self._confirmed(last)
            # without some limit
            for name in self._relaxable:
                progress(0.8, f"without the {name}")
                yield from self._relaxed(raced, last, name)
            yield from self._front(merged([race.front for race in last]))
            progress(1.0, "done")

    def _begun(self, raced: Raced, chosen: Sequence[Recipe], *, near: bool = False) -> Iterator[Race]:
        """Races of recipes at their usual numbers, or near them."""
        starts = [(each, self._study.space.start(each)) for each in chosen]
        return raced([(begun, recipe, self._near(start) if near else start, self._tighter) for recipe, start in starts])

    def _near(self, start: RealArray) -> RealArray:
        return np.asarray(np.clip(start + SPREAD * self._random.standard_normal(len(start)), 0.0, 1.0))

    def _rounds(
        self, raced: Raced, races: Sequence[Race], rounds: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[float, list[Race]]]:
        """Yield the finished fraction, and the races of each round after a few more steps."""
        total, passed, races = sum(count * steps for count, steps in rounds), 0, list(races)
        for count, steps in rounds:
            for first in range(0, steps, PIECE):
                # the best that aren't over; those that are make room for others
                length = min(PIECE, steps - first)
                races = [replace(race, tighter={**race.tighter, **self._tighter}) for race in races]
                able = [k for k, race in enumerate(races) if not race.over]
                going = sorted(able, key=[race.cost for race in races].__getitem__)[:count]
                for k, race in zip(going, raced([(improved, races[k], length) for k in going]), strict=True):
                    races[k] = race
                passed += count * length
                yield passed / total, races

    def _relaxed(self, raced: Raced, races: Sequence[Race], name: str) -> Iterator[Found]:
        """Yield the best motion that may exceed a limit, if it gains by that."""
        own = self._reported, self._within
        races = sorted(races, key=lambda race: race.cost)[:KEPT]
        free = [replace(race, tighter={**race.tighter, name: 0.0}, radius=RADIUS, front=()) for race in races]
        chosen = list(dict.fromkeys(race.recipe for race in races))
        others = [replace(each, tighter={**each.tighter, name: 0.0}) for each in self._begun(raced, chosen)]
        *_, (_, last) = self._rounds(raced, [*free, *others], RELAXED)
        yield from self._confirmed(last)
        self._reported, self._within = own

    def _confirmed(self, races: Sequence[Race]) -> Iterator[Found]:
        """Yield the best motion if it is better than all before and the judge finds it within limits too."""
        race = min(races, key=lambda race: race.cost)
        if race.best is None or race.cost > self._reported - BETTER:
            return
        judged = self._judge.tried(race.best.design)
        if judged is None:
            return
        without = tuple(name for name, factor in race.tighter.items() if factor == 0.0)
        # between the variants and instants of the quick runs a limit may be exceeded
        exceeded = {
            name: judged.score.uses[name] / use
            for name, use in race.best.score.uses.items()
            if name != CLEARANCE and race.tighter.get(name, 1.0) and use <= 1.0 < judged.score.uses[name]
        }
        if exceeded:
            further = {name: min(SAFETY * ratio, WIDEST) for name, ratio in exceeded.items()}
            self._tighter = {**self._tighter, **further}
            return
        # until limits hold, what exceeds them least
        within = set(judged.score.exceeded) <= set(without)
        if within or not self._within:
            self._reported, self._within = race.cost, self._within or within
            yield Found(judged, without)

    def _front(self, front: Sequence[Member]) -> Iterator[Found]:
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


def _without_clearance(race: Race) -> float:
    """Cost of a race but for the clearance, which depends on corners rather than on shapers."""
    return inf if race.best is None else race.best.score.cost({**race.tighter, CLEARANCE: 0.0})


def _raced(study: Study, task: tuple[Any, ...]) -> Race:
    """The race that a function makes of a study and further arguments."""
    function, *arguments = task
    found: Race = function(study, *arguments)
    return found
