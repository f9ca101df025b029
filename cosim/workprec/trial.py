"""Measured points of a work-precision diagram, and the curve that they make."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from time import process_time
from typing import TypeVar

import numpy as np

ENOUGH = 0.1
"""Processor time [s] after which a trial isn't repeated any more."""

MOST = 15
"""Most repetitions of a trial."""

TOO_SLOW = 100.0
"""A tool that takes so many times our time for an error needs no settings that take longer."""

TINY = 1e-300
"""Error of a result without any, as far as logarithms are concerned."""

Setting = TypeVar("Setting")


@dataclass(frozen=True)
class Trial:
    """One setting of one line.

    Attributes:
        family: which question it belongs to, for example ``integrators``.
        line: what is varied along a line, for example ``gauss4``.
        label: the setting, for example ``1e-5``.
        error: relative to what elasticity does; None where the run failed.
        time: processor time of a run [s]; None where the run failed.
        note: why it failed, or what else there is to know.
    """

    family: str
    line: str
    label: str
    error: float | None
    time: float | None
    note: str = ""

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.error is None


@dataclass(frozen=True)
class Curve:
    """The time that an accuracy takes with one tool.

    Attributes:
        trials: the settings that no other one of the tool beats in both error and time, by ascending error.
    """

    trials: tuple[Trial, ...]

    @classmethod
    def of(cls, trials: Iterable[Trial]) -> Curve:
        """The curve of all settings that were tried; failures and those that another one beats are left out."""
        good = [each for each in trials if each.error is not None and each.time is not None]
        best: list[Trial] = []
        for each in sorted(good, key=lambda each: (each.error, each.time)):
            if not best or (each.time or 0.0) < (best[-1].time or 0.0):
                best.append(each)
        return cls(tuple(best))

    @property
    def least(self) -> float:
        """Smallest error that was reached; infinite without any."""
        return self.trials[0].error or 0.0 if self.trials else np.inf

    @property
    def most(self) -> float:
        """Largest error of a setting that none beats; 0 without any."""
        return self.trials[-1].error or 0.0 if self.trials else 0.0

    def time(self, error: float) -> float | None:
        """Processor time [s] for at most this error, logarithms interpolated between two settings; None where none reached it."""
        if error < max(self.least, TINY):
            return None
        errors, times = (np.array([getattr(each, key) for each in self.trials]) for key in ("error", "time"))
        return float(np.exp(np.interp(np.log(error), np.log(np.maximum(errors, TINY)), np.log(times))))


def sweep(settings: Iterable[Setting], run: Callable[[Setting], Trial], ours: Curve) -> Iterator[Trial]:
    """Trials of another tool, the loosest setting first, until it is as accurate as our best or `TOO_SLOW` for its error."""
    for setting in settings:
        trial = run(setting)
        yield trial
        if trial.error is None or trial.time is None:
            continue
        our_time = ours.time(trial.error)
        if trial.error <= ours.least < np.inf or (our_time is not None and trial.time >= TOO_SLOW * our_time):
            return


def fastest(run: Callable[[], object]) -> float:
    """Processor time [s] of the fastest of several runs; the first of them warms up."""
    best = total = _timed(run)
    for _ in range(MOST):
        if total > ENOUGH:
            break
        taken = _timed(run)
        best, total = min(best, taken), total + taken
    return best


def fastest_in_turns(runs: Sequence[Callable[[], object]]) -> tuple[float, ...]:
    """Processor times [s] of the fastest of several runs of each, for comparison: a machine is faster at one moment than at another."""
    best = [_timed(run) for run in runs]
    total = sum(best)
    for _ in range(MOST):
        if total > ENOUGH * len(runs):
            break
        taken = [_timed(run) for run in runs]
        best, total = [min(pair) for pair in zip(best, taken, strict=True)], total + sum(taken)
    return tuple(best)


def _timed(run: Callable[[], object]) -> float:
    begin = process_time()
    run()
    return process_time() - begin
