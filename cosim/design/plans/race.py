"""Recipes improve side by side, by linear programmes on the runs of motions whose numbers differ a little."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from flexfmu.cosim.design.plans.descent import best_change
from flexfmu.cosim.design.plans.designs import Design, references
from flexfmu.cosim.design.plans.quick_runs import QuickRobot
from flexfmu.cosim.design.plans.recipes import Recipe, Space
from flexfmu.cosim.design.plans.scoring import Bounds, Figures, Score
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray

DIFFERENCE = 2e-3
"""Change of a number for differences."""

RADIUS, LARGEST, SMALLEST = 0.1, 0.3, 1e-3
"""First, largest and smallest trust region, in each number."""

GOOD, GROWTH, SHRINKAGE = 0.5, 2.0, 0.35
"""Part of the predicted decrease from which on the trust region grows, and how it grows and shrinks."""

CORRECTIONS = 4
"""How often the time of a motion is corrected until its limits hold."""

POWERS = {"torque": 0.5, "speed": 1.0, "acceleration": 0.5, "jerk": 1.0 / 3.0, "power": 1.0 / 3.0, "rms_torque": 0.5}
"""How the time scales with the use of a limit."""

RESIDUAL, MOST = 0.1, 1.5
"""The same of the residual vibration, which falls faster, and the largest ratio of a correction."""

FRONT = ("time", "residual", "torque", "energy")
"""Figures of the front: a motion that is worse in all of them than another one is dropped."""


@dataclass(frozen=True)
class Trial:
    """A motion and its figures."""

    design: Design
    score: Score


@dataclass(frozen=True)
class Member:
    """A motion of a front."""

    design: Design
    figures: Figures


@dataclass(frozen=True)
class Study:
    """What trials need.

    Attributes:
        scene: the motion-driven scene.
        space: what may be chosen.
        robot: for quick runs of all variants.
        bounds: limits.
    """

    scene: Scene
    space: Space
    robot: QuickRobot
    bounds: Bounds

    def tried(self, design: Design, steps: int | None = None) -> Trial | None:
        """Run a motion, in so many communication steps; None if it can't be planned or run."""
        try:
            motion = references(self.scene, design, self.robot.steps(design.total) if steps is None else steps)
            return Trial(design, Score(self.robot.run(motion), self.bounds))
        except (TrajectoryError, CosimError):
            return None

    def at(self, recipe: Recipe, point: RealArray, steps: int | None = None) -> Trial | None:
        """Run the motion of a point of the unit cube."""
        try:
            return self.tried(self.space.design(recipe, point), steps)
        except TrajectoryError:
            return None


@dataclass(frozen=True)
class Race:
    """A recipe's search.

    Attributes:
        recipe: the recipe.
        point: (n,) the numbers of the best motion.
        best: that motion; None for none.
        radius: of the trust region.
        front: motions within limits, none of which is worse than another in all figures.
        tighter: factors of the limits' uses; 0 for limits that play no part.
    """

    recipe: Recipe
    point: RealArray
    best: Trial | None = None
    radius: float = RADIUS
    front: tuple[Member, ...] = ()
    tighter: Mapping[str, float] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """What is minimised, as a logarithm, with exceeded limits added; infinite without a motion."""
        return inf if self.best is None else self.best.score.cost(self.tighter)

    @property
    def over(self) -> bool:
        """Whether the trust region is too small to go on."""
        return self.best is None or self.radius < SMALLEST


def begun(study: Study, recipe: Recipe, start: RealArray, tighter: Mapping[str, float]) -> Race:
    """A recipe at some numbers, with a time at which the limits hold if that is possible."""
    race, total = Race(recipe, start, tighter=tighter), study.space.usual
    for _ in range(CORRECTIONS if study.space.total is None else 1):
        point = study.space.with_total(start, total)
        trial = study.at(recipe, point)
        if trial is None:
            total *= MOST
            continue
        if trial.score.cost(tighter) < race.cost:
            race = replace(race, point=point, best=trial, front=_kept(race, trial))
        total = trial.design.total * _stretch(trial.score, tighter)
    return race


def _stretch(found: Score, tighter: Mapping[str, float]) -> float:
    """Ratio of durations by which the limits would just hold."""
    uses = {name: use * tighter.get(name, 1.0) for name, use in found.uses.items()}
    ratios = [max(uses[name], 1e-9) ** power for name, power in POWERS.items() if uses.get(name, 0.0) > 0.0]
    ratio = max(ratios, default=1.0)
    # residual vibration only slows a motion down, by and by
    if uses.get("residual", 0.0) > 1.0:
        ratio = max(ratio, uses["residual"] ** RESIDUAL)
    return float(np.clip(ratio, 1.0 / MOST, MOST))


def improved(study: Study, race: Race, steps: int) -> Race:
    """The race after so many further linear programmes."""
    for _ in range(steps):
        if race.over:
            break
        race = _step(study, race)
    return race


def _step(study: Study, race: Race) -> Race:
    assert race.best is not None
    # differences in each number, towards the middle of the cube, with as many instants
    count = len(race.best.score.run.motion.time) - 1
    differences = np.where(race.point > 0.5, -DIFFERENCE, DIFFERENCE)
    trials = [study.at(race.recipe, race.point + change, count) for change in np.diag(differences)]
    neighbours = [None if each is None else each.score for each in trials]
    # shorter steps until the motion is better
    while not race.over:
        low, high = np.maximum(-race.radius, -race.point), np.minimum(race.radius, 1.0 - race.point)
        forward = study.space.forward(race.recipe, race.point)
        change, predicted = best_change(race.best.score, neighbours, differences, race.tighter, low, high, forward)
        point = np.clip(race.point + change, 0.0, 1.0)
        trial = study.at(race.recipe, point)
        gained = -inf if trial is None else race.cost - trial.score.cost(race.tighter)
        if trial is not None and gained > 0.0:
            larger = gained > GOOD * predicted and np.abs(change).max() > 0.9 * race.radius
            radius = min(LARGEST, race.radius * GROWTH) if larger else race.radius
            if gained < 0.1 * predicted:
                radius *= SHRINKAGE
            return replace(race, point=point, best=trial, radius=radius, front=_kept(race, trial))
        race = replace(race, radius=race.radius * SHRINKAGE)
    return race


def _kept(race: Race, trial: Trial) -> tuple[Member, ...]:
    """The front of a race with a further motion, if it is within limits and no other is better in all figures."""
    # of the run only the figures are needed later, or all again
    member = Member(trial.design, trial.score.figures)
    trial.score.cost(race.tighter)
    trial.score.forget()
    allowed = {name for name, factor in race.tighter.items() if factor == 0.0}
    return undominated((*race.front, member)) if set(member.figures.exceeded) <= allowed else race.front


def undominated(members: Sequence[Member]) -> tuple[Member, ...]:
    """The members of a front without those that the last one beats in all figures of `FRONT`; without it if one beats it."""
    figures = np.array([[each.figures.values[name] for name in FRONT] for each in members])
    if (figures[:-1] <= figures[-1]).all(axis=1).any():
        return tuple(members[:-1])
    beaten = (figures[:-1] >= figures[-1]).all(axis=1)
    return (*(each for each, out in zip(members[:-1], beaten, strict=True) if not out), members[-1])


def merged(fronts: Sequence[tuple[Member, ...]]) -> tuple[Member, ...]:
    """One front of several."""
    front: tuple[Member, ...] = ()
    for member in (each for members in fronts for each in members):
        front = undominated((*front, member))
    return front
