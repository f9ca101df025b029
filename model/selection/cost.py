"""Cost of sets of effects: operations of the equations, and their computing time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import process_time

import casadi
import numpy as np

from flexfmu.model.numeric import NumericModel, numeric_model
from flexfmu.model.scene.schema import Scene

EVALUATIONS, ROUNDS = 100, 40
"""Evaluations in one timed run, and number of runs; the shortest run counts, as other processes disturb it least."""

POSE = ((2.5,), (0.5,), (0.0,), (0.0,), (0.0,), (0.0,))
"""Motor angles, rates and accelerations of the timed evaluations: a regular pose at rest."""


@dataclass(frozen=True)
class Cost:
    """Cost of one evaluation of the equations of motion and of the outputs.

    Attributes:
        states: number of elastic coordinates.
        operations: number of elementary operations.
        time: CPU time [s] in CasADi's interpreter; compiled C is faster by a factor common to all sets.
    """

    states: int
    operations: int
    time: float


def costs(scenes: Sequence[Scene]) -> tuple[Cost, ...]:
    """The costs of the scenes' sets of effects, timed in turns, as the speed of a machine varies."""
    models = [numeric_model(scene) for scene in scenes]
    runs = [_run(model) for model in models]
    times = [min(column) for column in zip(*([run() for run in runs] for _ in range(ROUNDS)), strict=True)]
    return tuple(
        Cost(model.n, model.elastic_forces.n_instructions() + model.motion.n_instructions(), time)
        for model, time in zip(models, times, strict=True)
    )


def _run(model: NumericModel) -> Callable[[], float]:
    """A function that evaluates the model `EVALUATIONS` times and returns the CPU time of one evaluation [s]."""
    # functions and arguments of all evaluations at once
    mapped = [function.map(EVALUATIONS) for function in (model.elastic_forces, model.motion)]
    at_rest = (np.zeros((model.n, EVALUATIONS)),) * 3
    arguments = [casadi.DM(each) for each in (*at_rest, np.tile(POSE, EVALUATIONS))]

    def run() -> float:
        started = process_time()
        for function in mapped:
            function.call(arguments)
        return (process_time() - started) / EVALUATIONS

    return run
