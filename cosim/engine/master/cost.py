"""Estimates computing time and memory of a long run before it starts.

The computing time of a communication step is measured on the first steps, in a child process where the platform allows
it, so that the slaves don't change. Memory follows from the number of values.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from time import perf_counter

from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, in_child
from flexfmu.cosim.engine.master.outcome import Simulation
from flexfmu.cosim.engine.master.recorder import SPEND_LESS

MANY_POINTS, MANY_VALUES = 10**7, 10**8
"""Numbers of communication steps and of recorded values above which the user is warned of the cost."""

FEW_STEPS, TRIED_STEPS = 500, 2500
"""Numbers of steps of the two trials; the initialisation cancels in the difference of their times."""

BYTES_PER_VALUE = 8.0
"""Bytes per recorded value; the results use the recorder's memory (`benchmarks/long_runs.py`)."""


def is_long(steps: int, values: int) -> bool:
    """Whether a run of so many steps and recorded values is long enough for a warning of its cost."""
    return steps > MANY_POINTS or values > MANY_VALUES


def cost(steps: int, values: int, trial: Callable[[int], Simulation]) -> str:
    """A sentence with a run's computing time and memory, and how to reduce them.

    Args:
        steps: communication steps.
        values: recorded values.
        trial: simulates the first steps, as many as its argument says.
    """
    seconds = None
    # an error occurs again in the run, which reports it better; the sentence then leaves out the time
    with suppress(Exception):
        seconds = (
            in_child(lambda: _seconds_per_step(trial), lambda: None, CALL_LIMIT)
            if AVAILABLE
            else _seconds_per_step(trial)
        )
    time = ""
    if seconds is not None:
        duration = seconds * steps
        unit, size = ("h", 3600.0) if duration > 5400.0 else ("min", 60.0) if duration > 90.0 else ("s", 1.0)
        time = f"{duration / size:.2g} {unit} and "
    gigabytes = 1e-9 * BYTES_PER_VALUE * values
    return (
        f"this run makes {steps:.3g} communication steps and records {values:.3g} values: it takes about {time}"
        f"{gigabytes:.2g} GB of memory or temporary files; to spend less, {SPEND_LESS}"
    )


def _seconds_per_step(trial: Callable[[int], Simulation]) -> float | None:
    """Computing time per communication step, references included [s]; None if a trial ends early."""
    taken = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # two trials, which take the same time to initialise
        for steps in (FEW_STEPS, TRIED_STEPS):
            begin = perf_counter()
            if trial(steps).steps < steps:
                return None
            taken.append(perf_counter() - begin)
    return max(taken[1] - taken[0], 0.0) / (TRIED_STEPS - FEW_STEPS)
