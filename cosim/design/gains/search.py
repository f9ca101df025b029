"""What a tuning has tried, what each trial costs, and what is left."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import log

import numpy as np

from flexfmu.cosim.design.gains.goals import Condition
from flexfmu.cosim.design.gains.journal import Journal
from flexfmu.cosim.design.gains.trial import Study, Trial, Trials
from flexfmu.cosim.engine.slave import RealArray

STARTS = 3
"""Number of the best trials of the first points that are improved, one after the other, as long as trials are left."""

STRICT = 10.0
"""Weight of a condition's excess, relative to its limit, beside the logarithm of the figure."""

FAILED = 1.0
"""What a failed trial counts for: a figure this much (in its logarithm) above the worst so far, and conditions exceeded by it."""

Show = Callable[[str, float | None], None]
"""Shows what is being done, and the finished fraction."""


class Spent(Exception):  # noqa: N818 - it ends a search as planned
    """All trials are made."""


class Search:
    """Trials that have been made, and those that are left.

    Args:
        study: what is tuned.
        workers: try values.
        total: number of trials.
        journal: what was tried before.
        show: is called with what is being done.

    Attributes:
        done: the trials in their order.
    """

    def __init__(self, study: Study, workers: Trials, total: int, journal: Journal | None, show: Show) -> None:
        self.study, self.total, self.done = study, total, list[Trial]()
        self._workers, self._journal, self._show = workers, journal, show
        self._known: dict[tuple[float, ...], Trial] = {}

    def try_all(self, points: Sequence[tuple[float, ...]]) -> list[Trial]:
        """Return the trials of these values; equal ones are made once.

        Raises:
            Spent: all trials are made before these.
        """
        new = [each for each in dict.fromkeys(points) if each not in self._known]
        left = self.total - len(self.done)
        spent, new = len(new) > left, new[:left]
        # those of an earlier tuning, and those that must be run, in their order
        before = {} if self._journal is None else self._journal.trials
        runs = self._workers.of([each for each in new if each not in before])
        for each in new:
            trial = before[each] if each in before else next(runs)
            if self._journal is not None and each not in before:
                self._journal.add(trial)
            self._known[each] = trial
            self.done.append(trial)
            self._tell()
        if spent:
            raise Spent
        return [self._known[each] for each in points]

    def costs_at(self, shares: RealArray) -> RealArray:
        """The costs of the values at shares (n,) of the intervals.

        Raises:
            Spent: all trials are made before that.
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

    def _tell(self) -> None:
        goal = self.study.minimise
        best = min(self.done, key=self.study.rank)
        kept = "" if self.study.rank(best)[0] == 0 else ", not within all limits"
        text = f"{len(self.done)} of {self.total} trials, {goal.name} {goal.shown(goal.of(best.figures))}{kept}"
        self._show(text, min(1.0, len(self.done) / self.total))


def _eased(conditions: Sequence[Condition], trial: Trial) -> list[float]:
    """By how much conditions are exceeded, for each joint: from a tenth of the limit on as the logarithm, at least -1."""
    found = [STRICT * one for each in conditions for one in each.excesses(trial.figures)]
    return [max(one, -1.0) if one <= 1.0 else 1.0 + log(min(one, 1e9)) for one in found]
