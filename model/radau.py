"""Radau IIA collocation in a step of length 1.

Its last stage is the end of the step, and it damps vibrations that are much faster than the step. With s stages its order is
2 s - 1.

Source: E. Hairer and G. Wanner, *Solving Ordinary Differential Equations II*, Springer 1996, section IV.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import casadi
import numpy as np

from flexfmu.trajectories.jets import RealArray


@dataclass(frozen=True, eq=False)
class Radau:
    """The method with s stages.

    Attributes:
        nodes: stages as fractions of the step (s,); the last one is 1.
        matrix: weights of the stages in integrals from the start of the step to each stage, (s, s); the last row is for the step.
        twice: weights in double integrals (s, s).
    """

    nodes: RealArray
    matrix: RealArray
    twice: RealArray


@cache
def radau(stages: int) -> Radau:
    """Return the method with 1 to 9 stages."""
    nodes, powers = np.array(casadi.collocation_points(stages, "radau")), np.arange(stages)
    # exact for all polynomials of a lower degree than the number of stages
    moments = nodes ** (powers[:, np.newaxis] + 1) / (powers[:, np.newaxis] + 1)
    matrix = np.asarray(np.linalg.solve(nodes ** powers[:, np.newaxis], moments).T, dtype=float)
    return Radau(nodes, matrix, matrix @ matrix)
