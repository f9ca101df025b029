"""Measurement of wall time and processor time."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from time import perf_counter, process_time

ENOUGH = 0.1
"""Total processor time [s] per trial after which it is no longer repeated."""

MOST = 15
"""Most repetitions of a trial."""


class Stopwatch:
    """Measures wall time between laps."""

    def __init__(self) -> None:
        self._since = perf_counter()

    def lap(self) -> float:
        """Time since the last lap, or since the start [s]."""
        last, self._since = self._since, perf_counter()
        return self._since - last


def processor_time() -> float:
    """Processor time [s] of this process and of those that it has started and that have ended."""
    return process_time() + sum(os.times()[2:4])


def fastest(run: Callable[[], object]) -> float:
    """Processor time [s] of the fastest of several runs, the first of which warms up."""
    return fastest_in_turns([run])[0]


def fastest_in_turns(runs: Sequence[Callable[[], object]]) -> tuple[float, ...]:
    """Processor time [s] of the fastest of several runs of each function, run in turns since a machine's speed varies."""
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
