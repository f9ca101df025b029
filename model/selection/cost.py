"""What a set of effects costs: operations of its equations, and the time that these take."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from time import process_time

import casadi
import numpy as np

from flexfmu.model.numeric import numeric_model
from flexfmu.model.scene import Scene

EVALUATIONS, REPETITIONS = 100, 40
"""The best of many short repetitions is timed: the shorter, the less other work gets in between."""


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


@lru_cache(maxsize=64)
def cost(scene: Scene) -> Cost:
    """The cost of a scene's set of effects."""
    model = numeric_model(scene)
    functions = model.elastic_forces, model.motion
    operations = sum(function.n_instructions() for function in functions)
    return Cost(model.n, operations, sum(_time(function, model.n) for function in functions))


def _time(function: casadi.Function, n: int) -> float:
    """Time of one evaluation at an unremarkable pose [s]."""
    mapped = function.map(EVALUATIONS)
    joints = np.tile([[2.5], [0.5], [0.0], [0.0], [0.0], [0.0]], EVALUATIONS)
    arguments = (*(np.zeros((n, EVALUATIONS)) for _ in range(3)), joints)
    times = []
    for _ in range(REPETITIONS):
        start = process_time()
        mapped(*arguments)
        times.append(process_time() - start)
    return min(times) / EVALUATIONS
