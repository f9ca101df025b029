"""Tunes gains and other keys of a scene: what serves best within limits, by runs and without derivatives.

First the scene's own values and points of a scrambled Sobol sequence over all intervals are tried, by all processors. The best of
them are then improved by COBYQA, a trust-region method with quadratic models that keeps the intervals and takes the conditions as
constraints (T. Ragonneau, Model-based derivative-free optimization methods and software, PhD thesis, Hong Kong 2022;
`scipy.optimize`). Equal intervals and seeds try equal values whatever the number of processors, so that an interrupted tuning
continues from its journal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import log
from typing import TYPE_CHECKING, Any

import numpy as np

from flexfmu.cosim.choices.gains.goals import Condition
from flexfmu.cosim.choices.gains.journal import Journal
from flexfmu.cosim.choices.gains.trial import Study, Trial, Trials, pool
from flexfmu.cosim.engine.errors import InputError, ResultsError, extra
from flexfmu.cosim.engine.showing import few_lines
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.scene.schema import Scene

if TYPE_CHECKING:
    import pandas

METHODS = ("trust-region", "sample")
"""What follows the first points: COBYQA, or further points of the sequence."""

FIRST, MOST_FIRST = 8, 64
"""First points for one key, twice as many for each further one, and the largest number of them."""

USUAL = 40
"""Trials for each key that follow the first points."""

RADIUS, LEAST_RADIUS = 0.15, 2e-3
"""First and last radius of the trust region, as shares of the intervals."""

STARTS = 3
"""Number of the best trials of the first points that are improved, one after the other, as long as trials are left."""

STRICT = 10.0
"""Weight of a condition's excess, relative to its limit, beside the logarithm of the figure."""

FAILED = 1.0
"""What a failed trial counts for: a figure this much (in its logarithm) above the worst so far, and conditions exceeded by it."""

Show = Callable[[str, float | None], None]
"""Shows what is being done, and the finished fraction."""


class _Spent(Exception):  # noqa: N818 - it ends a search as planned
    """All trials are made."""


@dataclass(frozen=True, repr=False)
class TuneResult:
    """Tuned values.

    Attributes:
        study: what was tuned, and for what.
        given: the scene as it was.
        best: the best trial; the given one if none is better.
        trials: all trials in their order, the given one first.
        interrupted: whether Ctrl-C ended it.
    """

    study: Study
    given: Trial
    best: Trial
    trials: tuple[Trial, ...] = field(repr=False)
    interrupted: bool = False

    @property
    def is_feasible(self) -> bool:
        """Whether the best trial keeps all limits."""
        return self.study.rank(self.best)[0] == 0

    @property
    def values(self) -> dict[str, float]:
        """Key → tuned value; empty where the given values are the best."""
        return {each.key: value for each, value in zip(self.study.over, self.best.values, strict=False)}

    @property
    def scene(self) -> Scene:
        """The tuned scene."""
        return self.study.changed(self.best.values)

    def rows(self) -> list[dict[str, Any]]:
        """The trials: values of the keys, figures, and a message where one failed."""
        names = list(dict.fromkeys(part for goal in self.study.goals for part in goal.parts))
        return [
            {
                "trial": number,
                **{
                    each.key: value
                    for each, value in zip(self.study.over, trial.values or self.study.given(), strict=True)
                },
                **{name: trial.figures.get(name) for name in names},
                "within_limits": self.study.rank(trial)[0] == 0,
                "message": trial.message,
            }
            for number, trial in enumerate(self.trials)
        ]

    def to_pandas(self) -> pandas.DataFrame:
        """The trials as a data frame.

        Raises:
            InputError: pandas isn't installed.
        """
        with extra("pandas"):
            import pandas
        return pandas.DataFrame(self.rows()).set_index("trial")

    def __repr__(self) -> str:
        """Return at most five lines."""
        goal = self.study.minimise
        shown = [goal.shown(goal.of(each.figures)) for each in (self.given, self.best)]
        head = f"Tuned {self.study.scene.name}: {goal.name} {shown[1]} (given {shown[0]}), {len(self.trials)} trials"
        within = "" if self.is_feasible else "; no trial keeps all limits"
        return few_lines(f"{head}{within}", [f"{key} = {value:g}" for key, value in self.values.items()])


def tune_study(
    study: Study,
    *,
    method: str = "trust-region",
    trials: int | None = None,
    seed: int = 0,
    processes: int = 1,
    journal: Journal | None = None,
    show: Show = lambda text, fraction: None,
) -> TuneResult:
    """Try values and return the best ones; after Ctrl-C the best so far.

    Args:
        study: what is tuned, and for what.
        method: what follows the first points.
        trials: number of all trials; None for the usual one by the number of keys.
        seed: of the first points.
        processes: number of processes.
        journal: what was tried before, and where trials are kept.
        show: is called with what is being done.

    Raises:
        InputError: the method is unknown, or there are too few trials.
        ResultsError: all trials failed, or the journal can't be written.
        MissingCompilerError: there is no C compiler.
    """
    count = len(study.over)
    first = min(FIRST << (count - 1), MOST_FIRST)
    total = first + USUAL * count + 1 if trials is None else trials
    if method not in METHODS:
        raise InputError(f"there is no method {method!r} of tuning; choose from {', '.join(METHODS)}")
    if total < 2:
        raise InputError(f"tuning needs at least 2 trials, the given values and others, got {total}")
    with pool(study, processes) as workers:
        search = _Search(study, workers, total, journal, show)
        try:
            search.try_all([(), *_sobol(study, min(first, total - 1) if method != "sample" else total - 1, seed)])
            if method != "sample":
                _descend(search)
            interrupted = False
        except _Spent:
            interrupted = False
        except KeyboardInterrupt:
            interrupted = True
    if not search.done:
        raise KeyboardInterrupt
    best = min(search.done, key=study.rank)
    if study.rank(best)[0] == 2 and not interrupted:
        raise ResultsError(f"all {len(search.done)} trials failed, the first one: {search.done[0].message}")
    return TuneResult(study, search.done[0], best, tuple(search.done), interrupted)


class _Search:
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
            _Spent: all trials are made before these.
        """
        new = [each for each in dict.fromkeys(points) if each not in self._known]
        if new and len(self.done) >= self.total:
            raise _Spent
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
        return [self._known[each] for each in points]

    def at(self, shares: RealArray) -> tuple[float, ...]:
        """The values at shares (n,) of the intervals."""
        clipped = np.clip(shares, 0.0, 1.0).tolist()
        return tuple(each.at(share) for each, share in zip(self.study.over, clipped, strict=True))

    def cost(self, trial: Trial) -> RealArray:
        """The logarithm of the figure (itself where it may be negative), then by how much each condition is exceeded, for each joint.

        A failed trial has what is worse than all others.
        """
        goal, conditions = self.study.minimise, self.study.conditions
        known = [each for each in self.done if not each.message and goal.of(each.figures) is not None]
        values = [goal.of(each.figures) or 0.0 for each in known]
        positive = all(each > 0.0 for each in values)
        value = None if trial.message else goal.of(trial.figures)
        if value is None:
            worst = max(values, default=1.0)
            cost = log(worst) + FAILED if positive else worst + FAILED * max(abs(worst), 1.0)
            beyond = max((one for each in known for one in _eased(conditions, each)), default=0.0)
            return np.array([cost, *[max(beyond, 0.0) + FAILED for each in conditions for _ in each.goal.parts]])
        return np.array([log(value) if positive else value, *_eased(conditions, trial)])

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


def _sobol(study: Study, count: int, seed: int) -> list[tuple[float, ...]]:
    """The first points of a scrambled Sobol sequence."""
    from scipy.stats.qmc import Sobol

    sequence = Sobol(len(study.over), seed=seed)
    shares = sequence.random_base2(max(count - 1, 0).bit_length())[:count]
    return [tuple(each.at(share) for each, share in zip(study.over, row, strict=True)) for row in shares.tolist()]


def _descend(search: _Search) -> None:
    """Improve the best trials so far, one after the other, until nothing more is gained.

    Raises:
        _Spent: all trials are made before that.
    """
    from scipy.optimize import Bounds, NonlinearConstraint, minimize

    def cost(shares: RealArray) -> RealArray:
        return search.cost(search.try_all([search.at(shares)])[0])

    def figure(shares: RealArray) -> float:
        return float(cost(shares)[0])

    count = len(search.study.over)
    options: dict[str, Any] = {
        "method": "COBYQA",
        "bounds": Bounds(np.zeros(count), np.ones(count)),
        "constraints": [NonlinearConstraint(lambda x: cost(x)[1:], -np.inf, 0.0)] if search.study.conditions else [],
        "options": {"initial_tr_radius": RADIUS, "final_tr_radius": LEAST_RADIUS},
    }
    for start in search.starts():
        minimize(figure, start, **options)
