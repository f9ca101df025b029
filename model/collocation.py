"""Collocation in a step of length 1, by Gauss's or Radau's nodes.

With s stages the order is 2 s, or 2 s - 1 of Radau IIA. Gauss's methods keep the amplitude of a vibration, and with the same stages err
less by an order of magnitude. Radau's last stage is the end of the step, and it damps vibrations that are much faster than the step.

Source: E. Hairer and G. Wanner, *Solving Ordinary Differential Equations II*, Springer 1996, section IV.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import casadi
import numpy as np

from flexfmu.trajectories.jets import RealArray


@dataclass(frozen=True, eq=False)
class Collocation:
    """The method with s stages.

    Attributes:
        nodes: stages as fractions of the step (s,).
        matrix: weights of the stages in integrals from the start of the step to each stage, (s, s).
        twice: weights in double integrals (s, s).
        whole, whole_twice: weights in both integrals over the step (s,).
    """

    nodes: RealArray
    matrix: RealArray
    twice: RealArray
    whole: RealArray
    whole_twice: RealArray


@cache
def collocation(nodes: Literal["legendre", "radau"], stages: int) -> Collocation:
    """Return the method with 1 to 9 stages at these nodes."""
    places, powers = np.array(casadi.collocation_points(stages, nodes)), np.arange(stages)
    # exact for all polynomials of a lower degree than the number of stages
    ends = np.append(places, 1.0)
    moments = ends ** (powers[:, np.newaxis] + 1) / (powers[:, np.newaxis] + 1)
    weights = np.asarray(np.linalg.solve(places ** powers[:, np.newaxis], moments).T, dtype=float)
    matrix, whole = weights[:-1], weights[-1]
    return Collocation(places, matrix, matrix @ matrix, whole, whole @ matrix)
