"""One measured point of a work-precision diagram."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import process_time

ENOUGH = 0.1
"""Processor time [s] after which a trial isn't repeated any more."""

MOST = 15
"""Most repetitions of a trial."""


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
