"""Tunes gains and other keys of a scene by runs: what serves best within limits.

First the scene's own values and points of a scrambled Sobol sequence over all intervals are tried, by all processors. The best of
them are then improved, by gradients or without. Equal intervals and seeds try equal values whatever the number of processors, so
that an interrupted tuning continues from its journal.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from flexfmu.cosim.design.gains.descents import descend_by_gradients, descend_by_models
from flexfmu.cosim.design.gains.journal import Journal
from flexfmu.cosim.design.gains.search import Search, Show, Spent
from flexfmu.cosim.design.gains.trial import Study, Trial, pool
from flexfmu.cosim.engine.errors import InputError, ResultsError, extra
from flexfmu.cosim.engine.showing import few_lines
from flexfmu.model.scene.schema import Scene

if TYPE_CHECKING:
    import pandas

METHODS = ("gradient", "trust-region", "sample")
"""What follows the first points: a descent by gradients, one by quadratic models without them, or further points of the sequence."""

FIRST, MOST_FIRST = 8, 64
"""First points for one key, twice as many for each further one, and the largest number of them."""

USUAL = 40
"""Trials for each key that follow the first points."""


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
    method: str = "gradient",
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
        search = Search(study, workers, total, journal, show)
        try:
            search.try_all([(), *_sobol(study, min(first, total - 1) if method != "sample" else total - 1, seed)])
            if method != "sample":
                descend = descend_by_models if method == "trust-region" else descend_by_gradients
                descend(search)
            interrupted = False
        except Spent:
            interrupted = False
        except KeyboardInterrupt:
            interrupted = True
    if not search.done:
        raise KeyboardInterrupt
    best = min(search.done, key=study.rank)
    if study.rank(best)[0] == 2 and not interrupted:
        raise ResultsError(f"all {len(search.done)} trials failed, the first one: {search.done[0].message}")
    return TuneResult(study, search.done[0], best, tuple(search.done), interrupted)


def _sobol(study: Study, count: int, seed: int) -> list[tuple[float, ...]]:
    """The first points of a scrambled Sobol sequence."""
    from scipy.stats.qmc import Sobol

    sequence = Sobol(len(study.over), seed=seed)
    shares = sequence.random_base2(max(count - 1, 0).bit_length())[:count]
    return [tuple(each.at(share) for each, share in zip(study.over, row, strict=True)) for row in shares.tolist()]
