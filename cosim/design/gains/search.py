"""What a tuning has tried, what each trial costs, and the descent from the best trials by gradients.

Loops have rounding, limits and events, and their figures are peaks: their derivatives are differences of runs. The largest of
several figures has a kink, each of them is smooth: programmes bound all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import log

import casadi
import numpy as np

from flexfmu.cosim.design.gains.goals import Condition
from flexfmu.cosim.design.gains.trial import Study, Trial
from flexfmu.cosim.engine.showing import ShowProgress
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.many.journal import WorkJournal

STARTS = 3
"""Number of the best trials of the first points that are improved, one after the other, as long as trials are left."""

RADIUS, LEAST_RADIUS = 0.15, 2e-3
"""First and last radius of the trust region, as shares of the intervals."""

DIFFERENCE = 4e-3
"""Step of differences, as a share of the interval: large beside a run's error, small beside the curvature of figures."""

LARGEST_RADIUS, SHRINKING = 0.5, 0.4
"""Largest radius in a descent by gradients; radius after a step that gained little, as a share of the step."""

LEAST_GAIN = 1e-4
"""Foreseen gain at which a descent by gradients ends: 0.01 % of the figure."""

PENALTY = 10.0
"""Weight of what exceeds a condition in a descent by gradients: 0.1 % of the limit like 10 % of the figure."""

GOOD, POOR = 0.75, 0.25
"""Share of the foreseen gain from which the trust region grows, and below which it shrinks."""

INSIDE = 1e-3
"""How far within a condition linear steps aim: 0.01 % of the limit."""

STRICT = 10.0
"""Weight of a condition's excess, relative to its limit, beside the logarithm of the figure."""

FAILED = 1.0
"""What a failed trial counts for: a figure this much (in its logarithm) above the worst so far, and conditions exceeded by it."""


class BudgetExceeded(Exception):  # noqa: N818 - it ends a search as planned
    """All trials are made."""


Tried = Callable[[Sequence[tuple[float, ...]]], Iterator[Trial]]
"""Several values → the trial of each, in their order."""


class Search:
    """Trials that have been made, and those that are left.

    Args:
        study: what is tuned.
        tried: several values → the trial of each.
        total: number of trials.
        journal: what was tried before.
        show: is called with what is being done.

    Attributes:
        done: the trials in their order.
    """

    def __init__(self, study: Study, tried: Tried, total: int, journal: WorkJournal, show: ShowProgress) -> None:
        self.study, self.total, self.done = study, total, list[Trial]()
        self._tried, self._journal, self._show = tried, journal, show
        self._known: dict[tuple[float, ...], Trial] = {}

    def try_all(self, points: Sequence[tuple[float, ...]]) -> list[Trial]:
        """Return the trials of these values; equal ones are made once.

        Raises:
            BudgetExceeded: all trials are made before these.
        """
        new = [each for each in dict.fromkeys(points) if each not in self._known]
        left = self.total - len(self.done)
        spent, new = len(new) > left, new[:left]
        # those of an earlier tuning, and those that must be run, in their order
        missing = [each for each in new if each not in self._journal]
        runs = map(self.study.tried, missing) if len(missing) == 1 else self._tried(missing)
        for each in new:
            self._known[each] = trial = self._journal.kept(each, Trial, lambda: next(runs))
            self.done.append(trial)
            # progress, with the best so far
            best, goal = min(self.done, key=self.study.rank), self.study.minimise
            kept = "" if self.study.rank(best)[0] == 0 else ", not within all limits"
            text = f"{len(self.done)} of {self.total} trials, {goal.name} {goal.shown(goal.of(best.figures))}{kept}"
            self._show(text, min(1.0, len(self.done) / self.total))
        if spent:
            raise BudgetExceeded
        return [self._known[each] for each in points]

    def costs_at(self, shares: RealArray) -> RealArray:
        """The costs of the values at shares (n,) of the intervals.

        Raises:
            BudgetExceeded: all trials are made before that.
        """
        return self.cost(self.try_all([self.at(shares)])[0])

    def at(self, shares: RealArray) -> tuple[float, ...]:
        """The values at shares (n,) of the intervals."""
        clipped = np.clip(shares, 0.0, 1.0).tolist()
        return tuple(each.at(share) for each, share in zip(self.study.over, clipped, strict=True))

    def cost(self, trial: Trial) -> RealArray:
        """What the figure's parts cost, then by how much each condition is exceeded; for each joint.

        Parts cost their logarithm, or themselves where they may be negative. A failed trial has what is worse than all others.
        """
        goal, conditions = self.study.minimise, self.study.conditions
        known = [each for each in self.done if not each.message and goal.of(each.figures) is not None]
        values = [each.figures[part] or 0.0 for each in known for part in goal.parts]
        positive = all(each > 0.0 for each in values)
        if trial.message or goal.of(trial.figures) is None:
            worst = max(values, default=1.0)
            cost = log(worst) + FAILED if positive else worst + FAILED * max(abs(worst), 1.0)
            beyond = max((one for each in known for one in _eased(conditions, each)), default=0.0)
            exceeded = [max(beyond, 0.0) + FAILED for each in conditions for _ in each.goal.parts]
            return np.array([*[cost for _ in goal.parts], *exceeded])
        parts = [trial.figures[part] or 0.0 for part in goal.parts]
        return np.array([*[log(each) if positive else each for each in parts], *_eased(conditions, trial)])

    def starts(self) -> list[RealArray]:
        """Shares (n,) of the best trials, from which descents begin."""
        found = []
        for trial in sorted(self.done, key=self.study.rank)[:STARTS]:
            values = trial.values or tuple(0.0 if each is None else each for each in self.study.given())
            found.append(np.array([each.share_of(one) for each, one in zip(self.study.over, values, strict=True)]))
        return found


def _eased(conditions: Sequence[Condition], trial: Trial) -> list[float]:
    """By how much conditions are exceeded, for each joint: from a tenth of the limit on as the logarithm, at least -1."""
    found = [STRICT * one for each in conditions for one in each.excesses(trial.figures)]
    return [max(one, -1.0) if one <= 1.0 else 1.0 + log(min(one, 1e9)) for one in found]


def descend_by_gradients(search: Search) -> None:
    """Improve the best trials so far, one after the other, by sequential quadratic programmes within a trust region.

    Each step has differences of runs, which all processors make at once, and a programme: the change of the shares that makes the
    largest part of the figure smallest and keeps all conditions. Both are linear about the last point; the curvature is that of the
    Lagrangian, by damped BFGS. Source: J. Nocedal and S. Wright, Numerical Optimization, 2006, chapter 18.

    Raises:
        BudgetExceeded: all trials are made before nothing more is gained.
    """
    for start in search.starts():
        _descend(search, start)


def _descend(search: Search, point: RealArray) -> None:
    """Go down from shares (n,) of the intervals."""
    parts = len(search.study.minimise.parts)
    costs, slopes = search.costs_at(point), _differences(search, point)
    curvature, radius = np.zeros((len(point), len(point))), RADIUS
    while radius > LEAST_RADIUS:
        step, expected, multipliers = _programmed(costs, slopes, curvature, parts, point, radius)
        if expected < LEAST_GAIN:
            return
        new = search.costs_at(point + step)
        if _merit(costs, parts) - _merit(new, parts) < GOOD * expected:
            # second-order correction: the same program about what the step has shown
            other, _, _ = _programmed(new - slopes @ step, slopes, curvature, parts, point, radius)
            if _merit(corrected := search.costs_at(point + other), parts) < _merit(new, parts):
                step, new = other, corrected
        # the region grows where the program foresaw the gain, and shrinks where it didn't
        gain = _merit(costs, parts) - _merit(new, parts)
        if gain > GOOD * expected:
            radius = min(2.0 * radius, LARGEST_RADIUS)
        elif gain < POOR * expected:
            radius = SHRINKING * min(radius, float(np.abs(step).max()))
        if gain > 0.0:
            before, slopes = slopes, _differences(search, point + step)
            curvature = _updated(curvature, step, multipliers @ (slopes - before))
            point, costs = point + step, new


def _merit(costs: RealArray, parts: int) -> float:
    """The largest part, and a penalty for what exceeds conditions."""
    return float(costs[:parts].max() + PENALTY * np.maximum(costs[parts:], 0.0).sum())


def _updated(curvature: RealArray, step: RealArray, change: RealArray) -> RealArray:
    """The curvature (n, n) after a step (n,) along which the gradient has changed, by damped BFGS: it stays positive."""
    if not curvature.any():
        # the first one is a sphere
        curvature = max(float(change @ step) / float(step @ step), 1e-6) * np.eye(len(step))
    known = curvature @ step
    along = float(step @ known)
    if (found := float(step @ change)) < 0.2 * along:
        share = 0.8 * along / (along - found)
        change = share * change + (1.0 - share) * known
    return np.asarray(curvature - np.outer(known, known) / along + np.outer(change, change) / float(step @ change))


def _programmed(
    costs: RealArray, slopes: RealArray, curvature: RealArray, parts: int, point: RealArray, radius: float
) -> tuple[RealArray, float, RealArray]:
    """The change (n,) of the shares within the radius that lowers costs most, by how much, and the multipliers of the costs."""
    n, conditions = len(point), len(costs) - parts
    # unknowns: the change, the largest part, the excess of each condition
    hessian = np.zeros((n + 1 + conditions,) * 2)
    hessian[:n, :n] = curvature
    rows = np.zeros((len(costs), n + 1 + conditions))
    rows[:, :n], rows[:parts, n], rows[parts:, n + 1 :] = slopes, -1.0, -np.eye(conditions)
    program = casadi.conic(
        "program",
        "highs",
        {"h": casadi.DM(hessian).sparsity(), "a": casadi.Sparsity.dense(*rows.shape)},
        {"highs": {"output_flag": False}, "error_on_fail": False},
    )
    found = program(
        h=hessian,
        g=np.concatenate([np.zeros(n), [1.0], np.full(conditions, PENALTY)]),
        a=rows,
        lba=-np.inf,
        uba=-np.concatenate([costs[:parts], costs[parts:] + INSIDE]),
        lbx=np.concatenate([np.maximum(-radius, -point), [-np.inf], np.zeros(conditions)]),
        ubx=np.concatenate([np.minimum(radius, 1.0 - point), np.full(1 + conditions, np.inf)]),
    )
    # a program that fails foresees no gain
    before = _merit(np.append(costs[:parts], costs[parts:] + INSIDE), parts)
    expected = before - float(found["cost"]) if program.stats()["success"] else 0.0
    return found["x"].full()[:n, 0], expected, found["lam_a"].full()[:, 0]


def _differences(search: Search, shares: RealArray) -> RealArray:
    """Derivatives (costs, n) by shares: differences to the inside of the intervals, to the other side where that run fails."""
    steps = np.where(shares + DIFFERENCE <= 1.0, DIFFERENCE, -DIFFERENCE)
    here = search.at(shares)
    base, *trials = search.try_all([here, *(search.at(shares + step) for step in np.diag(steps))])
    columns = []
    for i, trial in enumerate(trials):
        if trial.message and 0.0 <= shares[i] - steps[i] <= 1.0:
            steps[i] = -steps[i]
            trial = search.try_all([search.at(shares + steps[i] * np.eye(len(shares))[i])])[0]
        # values are rounded, so that the step is what was tried
        interval = search.study.over[i]
        moved = interval.share_of(trial.values[i]) - interval.share_of(here[i])
        columns.append((search.cost(trial) - search.cost(base)) / (moved or 1.0))
    return np.column_stack(columns)
