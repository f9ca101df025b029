"""Improves the numbers of motion families side by side, by linear programmes on runs of motions whose numbers differ a little.

All figures of a motion at all instants are linearised by differences in each number. A linear programme then finds the change within
a trust region that lowers what is minimised, with exceeded limits added, most; the region grows where the motion gains what was
predicted, and shrinks where it doesn't.

Source: J. Nocedal, S. J. Wright, *Numerical Optimization*, 2nd edition, Springer 2006, section 18.8 (sequential l1 linear-quadratic
programming), here without the quadratic part: as many limits are active as there are numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
from scipy.optimize import linprog

from flexfmu.cosim.design.plans.designs import Design, MotionFamily, Space, references
from flexfmu.cosim.design.plans.goals import FALLING
from flexfmu.cosim.design.plans.quick_runs import CLEARANCE, INSIDE, WORTH, Bounds, QuickRobot, Score
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray

NEAR, REACH = 0.35, 10.0
"""Rows within this of the largest, or of the limit, are linearised: others don't become active within a step. Those of the clearance
are `LENGTH` apart, see `flexfmu.cosim.design.plans.quick_runs`."""

MOST_ROWS = 2000
"""Largest number of rows of a limit."""

DIFFERENCE = 2e-3
"""Change of a number for differences."""

RADIUS, LARGEST, SMALLEST = 0.1, 0.3, 1e-3
"""First, largest and smallest trust region, in each number."""

GOOD, GROWTH, SHRINKAGE = 0.5, 2.0, 0.35
"""Part of the predicted decrease from which on the trust region grows, and how it grows and shrinks."""

CORRECTIONS = 4
"""How often the time of a motion is corrected until its limits hold."""

MOST = 1.5
"""The largest ratio of a correction."""

FrontMember = tuple[float, float, Design]
"""Time [s] and residual vibration [m] of a motion within limits, and the motion."""


@dataclass(frozen=True)
class MotionTrial:
    """A motion and its figures."""

    design: Design
    score: Score


@dataclass(frozen=True)
class MotionStudy:
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

    def tried(self, design: Design, steps: int | None = None) -> MotionTrial | None:
        """Run a motion, in so many communication steps; None if it can't be planned or run."""
        try:
            motion = references(self.scene, design, self.robot.steps(design.total) if steps is None else steps)
            return MotionTrial(design, Score(self.robot.run(motion), self.bounds))
        except (TrajectoryError, CosimError):
            return None

    def at(self, family: MotionFamily, point: RealArray, steps: int | None = None) -> MotionTrial | None:
        """Run the motion of a point of the unit cube."""
        try:
            return self.tried(self.space.design(family, point), steps)
        except TrajectoryError:
            return None


@dataclass(frozen=True)
class Iterate:
    """A family's search.

    Attributes:
        family: the family.
        point: (n,) the numbers of the best motion.
        best: that motion; None for none.
        radius: of the trust region.
        front: all its motions within limits.
        tighter: factors of the limits' uses.
    """

    family: MotionFamily
    point: RealArray
    best: MotionTrial | None = None
    radius: float = RADIUS
    front: tuple[FrontMember, ...] = ()
    tighter: Mapping[str, float] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """What is minimised, as a logarithm, with exceeded limits added; infinite without a motion."""
        return inf if self.best is None else self.best.score.cost(self.tighter)

    @property
    def over(self) -> bool:
        """Whether the trust region is too small to go on."""
        return self.best is None or self.radius < SMALLEST


def first_iterate(study: MotionStudy, family: MotionFamily, start: RealArray, tighter: Mapping[str, float]) -> Iterate:
    """A family at some numbers, with a time at which the limits hold if that is possible."""
    iterate, total = Iterate(family, start, tighter=tighter), study.space.usual
    for _ in range(CORRECTIONS if study.space.total is None else 1):
        point = study.space.with_total(start, total)
        trial = study.at(family, point)
        if trial is None:
            total *= MOST
            continue
        if trial.score.cost(tighter) < iterate.cost:
            iterate = replace(iterate, point=point, best=trial, front=_kept(iterate, trial))
        total = trial.design.total * _stretch(trial.score, tighter)
    return iterate


def _stretch(found: Score, tighter: Mapping[str, float]) -> float:
    """Ratio of durations by which the limits would just hold."""
    uses = {name: use * tighter.get(name, 1.0) for name, use in found.uses.items()}
    counts = {name for name, use in uses.items() if use > (1.0 if name == "residual" else 0.0)}
    ratio = max((max(uses[name], 1e-9) ** FALLING[name] for name in FALLING.keys() & counts), default=1.0)
    return float(np.clip(ratio, 1.0 / MOST, MOST))


def improved(study: MotionStudy, iterate: Iterate, steps: int) -> Iterate:
    """The iterate after so many further linear programmes."""
    for _ in range(steps):
        if iterate.over:
            break
        iterate = _step(study, iterate)
    return iterate


def _step(study: MotionStudy, iterate: Iterate) -> Iterate:
    assert iterate.best is not None
    # differences in each number, towards the middle of the cube, with as many instants
    count = len(iterate.best.score.run.motion.time) - 1
    differences = np.where(iterate.point > 0.5, -DIFFERENCE, DIFFERENCE)
    trials = [study.at(iterate.family, iterate.point + change, count) for change in np.diag(differences)]
    neighbours = [None if each is None else each.score for each in trials]
    # shorter steps until the motion is better
    while not iterate.over:
        low, high = np.maximum(-iterate.radius, -iterate.point), np.minimum(iterate.radius, 1.0 - iterate.point)
        forward = study.space.forward(iterate.family, iterate.point)
        change, predicted = best_change(
            iterate.best.score, neighbours, differences, iterate.tighter, low, high, forward
        )
        point = np.clip(iterate.point + change, 0.0, 1.0)
        trial = study.at(iterate.family, point)
        gained = -inf if trial is None else iterate.cost - trial.score.cost(iterate.tighter)
        if trial is not None and gained > 0.0:
            larger = gained > GOOD * predicted and np.abs(change).max() > 0.9 * iterate.radius
            radius = min(LARGEST, iterate.radius * GROWTH) if larger else iterate.radius
            if gained < 0.1 * predicted:
                radius *= SHRINKAGE
            return replace(iterate, point=point, best=trial, radius=radius, front=_kept(iterate, trial))
        iterate = replace(iterate, radius=iterate.radius * SHRINKAGE)
    return iterate


def best_change(
    score: Score,
    neighbours: list[Score | None],
    differences: RealArray,
    tighter: Mapping[str, float],
    low: RealArray,
    high: RealArray,
    further: tuple[RealArray, RealArray],
) -> tuple[RealArray, float]:
    """Return the change of the numbers (n,) with the smallest predicted cost, and the predicted decrease of the cost.

    Args:
        score: of the motion.
        neighbours: n scores, each with one number changed; None for one that can't be run.
        differences: (n,) changes of the numbers of these.
        tighter: as for `Score.cost`.
        low, high: (n,) bounds of the changes.
        further: linear functions that have to stay above zero: values (M,) and slopes (M, n).
    """
    known = np.array([each is not None for each in neighbours])
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    others = [score if each is None else each for each in neighbours]
    # what is minimised in its own unit, then the limits, each below 1 plus its excess
    unit = float(score.minimised.max()) or 1.0
    parts = [_part(score.minimised / unit, [each.minimised / unit for each in others], NEAR, 0.0)]
    now, weights = 1.0, [1.0]
    for name in score.rows:
        factor = tighter.get(name, INSIDE)
        worst = factor * float(score.rows[name].max())
        unit, reach = (1.0, REACH) if name == CLEARANCE else (max(1.0, worst), NEAR)
        rows, *shifted = (factor / unit * each.rows[name] for each in (score, *others))
        parts.append(_part(rows, shifted, reach, 1.0 / unit))
        now += WORTH * max(0.0, worst - 1.0) / unit
        weights.append(WORTH)
    # one slack for each of them
    slacks = np.repeat(-np.eye(len(parts)), [len(right) for _, right in parts], axis=0)
    slopes = np.concatenate([*(slopes / differences for slopes, _ in parts), -further[1]])
    found = linprog(
        np.array([*np.zeros(len(low)), *weights]),
        A_ub=np.hstack([slopes, np.concatenate([slacks, np.zeros((len(further[0]), len(parts)))])]),
        b_ub=np.concatenate([*(right for _, right in parts), further[0]]),
        bounds=[*zip(low, high, strict=True), *[(0.0, None)] * len(parts)],
        method="highs",
    )
    if found.x is None:
        return np.zeros(len(low)), 0.0
    return np.asarray(found.x[: len(low)]), now - float(found.fun or 0.0)


def _part(rows: RealArray, further: Sequence[RealArray], reach: float, limit: float) -> tuple[RealArray, RealArray]:
    """Differences (M, n) of the rows that may become active, and by how much each is below the limit (M,)."""
    index = np.flatnonzero(rows > min(float(rows.max()), limit) - reach)
    if index.size > MOST_ROWS:
        index = index[np.argsort(-rows[index], kind="stable")[:MOST_ROWS]]
    return np.stack([each[index] - rows[index] for each in further], axis=1), limit - rows[index]


def _kept(iterate: Iterate, trial: MotionTrial) -> tuple[FrontMember, ...]:
    """The motions of an iterate within limits, with a further one if it is."""
    # of the run only the figures are needed later, or all again
    values, feasible = trial.score.values, trial.score.feasible
    trial.score.forget()
    return (*iterate.front, (values["time"], values["residual"], trial.design)) if feasible else iterate.front
