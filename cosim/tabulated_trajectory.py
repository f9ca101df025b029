"""A trajectory by look-up: for a master that asks for a few points at a time, thousands of times."""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.cosim.errors import InputError
from flexfmu.cosim.measuring.hermite import two_point
from flexfmu.cosim.slave import RealArray
from flexfmu.fmu_build.trajectory_table import END_ORDER, KINDS, tabulate
from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.trajectory import Trajectory

ACCELERATION = len(KINDS) - 1
"""Derivatives of this order and higher come from the polynomials of the acceleration."""


TOLERANCE = 3e-14
"""Error of positions, velocities and accelerations relative to the largest; rounding allows a third of it."""


class TabulatedTrajectory:
    """Polynomials of degree 9 between knots, as in a trajectory's FMU, for position, velocity and acceleration.

    Higher derivatives are those of the acceleration's polynomials, which over a step give the same values.

    Args:
        trajectory: what to tabulate.

    Attributes:
        breakpoints: those of the trajectory [s].
        duration: duration of the motion [s].

    Raises:
        ModelError: no table reproduces the trajectory.
    """

    highest_order = ACCELERATION + END_ORDER

    def __init__(self, trajectory: Trajectory) -> None:
        table = tabulate(trajectory, TOLERANCE)
        self.breakpoints = tuple(trajectory.breakpoints)
        self.duration = trajectory.duration
        begins = np.flatnonzero(np.diff(table.times) > 0.0)
        self._begins, widths = table.times[begins], np.diff(table.times)[begins]
        jets = table.jets.swapaxes(0, 1)
        self._polynomials = [
            two_point(jets[k : k + END_ORDER + 1, begins], jets[k : k + END_ORDER + 1, begins + 1], widths[:, None])
            for k in range(len(KINDS))
        ]
        self._rest = jets[0, [0, -1]]

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Value and time derivatives, shape (order + 1, N, axes); see `flexfmu.trajectories.Trajectory.evaluate`.

        Raises:
            InputError: the order is above 6.
        """
        if not 0 <= order <= self.highest_order:
            raise InputError(f"a tabulated trajectory has derivatives of orders 0 to {self.highest_order}, got {order}")
        times = np.atleast_1d(np.asarray(time, dtype=np.float64))
        first, last = self.breakpoints[0], self.breakpoints[-1]
        early, late = (times < first, times >= last) if side == "right" else (times <= first, times > last)
        piece = np.maximum(np.searchsorted(self._begins, times, side) - 1, 0)
        elapsed = np.minimum(times, last) - self._begins[piece]
        # the polynomials at these points, and the powers of the time that all derivatives share
        here = [each[:, piece] for each in self._polynomials[: order + 1]]
        powers = np.array([elapsed**j / factorial(j) for j in range(len(here[0]))])
        jets = np.empty((order + 1, *here[0].shape[1:]))
        for k in range(order + 1):
            kind = min(k, ACCELERATION)
            terms = here[kind][k - kind :]
            np.einsum("jn,jna->na", powers[: len(terms)], terms, out=jets[k])
        for still, position in zip((early, late), self._rest, strict=True):
            jets[:, still] = 0.0
            jets[0, still] = position
        return jets
