"""What a long run will take in time and memory, estimated before it starts.

The time of a communication step is measured on the first ones, in a child process where the platform has them, so that slaves
stay as they are. Memory follows from the numbers of values.
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
"""Above these numbers of communication points or recorded values the user is warned of the cost."""

FEW_STEPS, TRIED_STEPS = 500, 2500
"""Lengths of the two trials; their difference leaves the initialisation out."""

BYTES_PER_VALUE = 19.0
"""Memory of a recorded value, as it comes and in its column (`benchmarks/long_runs.py`)."""

BYTES_PER_VALUE_IN_FILES = 50.0
"""The same while results.csv is written."""

BYTES_PER_REFERENCE, BYTES_KEPT = 300.0, 120.0
"""Memory of a reference at one point: while all are calculated, before the first step (`benchmarks/long_runs.py --points 2e6`),
and from then on."""


def is_long(steps: int, values: int) -> bool:
    """Whether the user is warned of a run's cost."""
    return steps > MANY_POINTS or values > MANY_VALUES


def cost(steps: int, values: int, references: int, trial: Callable[[int], Simulation]) -> str:
    """What a run will take and how to spend less, in one sentence.

    Args:
        steps: communication steps.
        values: recorded values.
        references: outputs that are calculated for all points before the first step.
        trial: simulates so many of the first steps.
    """
    seconds = None
    # what goes wrong now goes wrong in the run, whose message says more: then the time is left out
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
    # memory: references are all calculated before the first step, values recorded as they come
    tabulated = references * steps
    gigabytes = 1e-9 * max(BYTES_PER_REFERENCE * tabulated, BYTES_KEPT * tabulated + BYTES_PER_VALUE * values)
    return (
        f"this run makes {steps:.3g} communication steps and records {values:.3g} values: it takes about {time}"
        f"{gigabytes:.2g} GB of memory, {1e-9 * BYTES_PER_VALUE_IN_FILES * values:.2g} GB where results.csv is written; "
        f"to spend less, {SPEND_LESS}"
    )


def _seconds_per_step(trial: Callable[[int], Simulation]) -> float | None:
    """Time of a communication step, references included [s]; None where the first ones fail."""
    taken = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # two lengths, since both take the same time to initialise
        for steps in (FEW_STEPS, TRIED_STEPS):
            begin = perf_counter()
            if trial(steps).steps < steps:
                return None
            taken.append(perf_counter() - begin)
    return max(taken[1] - taken[0], 0.0) / (TRIED_STEPS - FEW_STEPS)
