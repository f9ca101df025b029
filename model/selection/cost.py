"""What sets of effects cost: operations of their equations, and the time that these take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import process_time

import casadi
import numpy as np

from flexfmu.model.numeric import NumericModel, numeric_model
from flexfmu.model.scene.schema import Scene

EVALUATIONS, ROUNDS = 100, 40
"""The best of many short repetitions is timed: the shorter, the less other work gets in between."""

POSE = ((2.5,), (0.5,), (0.0,), (0.0,), (0.0,), (0.0,))
"""Angles, velocities and accelerations of the motors at which equations are timed, an unremarkable pose at rest."""


@dataclass(frozen=True)
class Cost:
    """One evaluation of the equations of motion and of the outputs.

    Attributes:
        states: elastic coordinates.
        operations: elementary operations.
        time: measured time [s] by CasADi's own interpreter; compiled C is faster by a factor that all sets share.
    """

    states: int
    operations: int
    time: float


def costs(scenes: Sequence[Scene]) -> tuple[Cost, ...]:
    """The costs of some scenes' sets of effects, timed in turns: a machine is faster at one moment than at another."""
    models = [numeric_model(scene) for scene in scenes]
    runs = [_run(model) for model in models]
    times = [min(column) for column in zip(*([run() for run in runs] for _ in range(ROUNDS)), strict=True)]
    return tuple(
        Cost(model.n, model.elastic_forces.n_instructions() + model.motion.n_instructions(), time)
        for model, time in zip(models, times, strict=True)
    )


def _run(model: NumericModel) -> Callable[[], float]:
    """Evaluates a model's functions many times; the time of one evaluation [s]."""
    mapped = [function.map(EVALUATIONS) for function in (model.elastic_forces, model.motion)]
    at_rest = (np.zeros((model.n, EVALUATIONS)),) * 3
    arguments = [casadi.DM(each) for each in (*at_rest, np.tile(POSE, EVALUATIONS))]

    def run() -> float:
        started = process_time()
        for function in mapped:
            function.call(arguments)
        return (process_time() - started) / EVALUATIONS

    return run
