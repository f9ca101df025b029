"""An exported trajectory FMU as a trajectory, for `flexfmu.cosim.engine.trajectory_slave.TrajectorySlave`."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.trajectories.curves import Side

KINDS = 3
"""Number of outputs per axis: position, velocity and acceleration; higher derivatives are those of the acceleration."""


class FmuTrajectory:
    """A trajectory calculated by an FMU: `evaluate` steps the FMU from time to time.

    Args:
        path: FMU exported by `flexfmu.fmu_build.trajectory_build`.

    Attributes:
        breakpoints: breakpoints of the trajectory [s].
        axes: number of axes.

    Raises:
        FmuFileError: the FMU is missing or broken, or states no breakpoints.
    """

    def __init__(self, path: str | Path) -> None:
        points = open_fmu(Path(path)).breakpoints
        if not points:
            raise FmuFileError(f"{path} doesn't tell its breakpoints; run it as a slave that is stepped")
        self.breakpoints = points
        # one slave for left limits and one for right limits
        self._runs = {side: FmuSlave(path, f"trajectory, {side} limits", {"limit": side}) for side in get_args(Side)}
        variables = self._runs["right"].variables
        self._outputs = np.array([i for i, each in enumerate(variables) if each.causality == "output"], np.intp)
        self.axes = len(self._outputs) // KINDS

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.breakpoints[-1]

    @property
    def highest_order(self) -> int:
        """Order of the highest derivative that the FMU provides."""
        return KINDS - 1 + self._runs["right"].max_output_order

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return value and time derivatives (order + 1, N, axes); see `flexfmu.trajectories.Trajectory.evaluate`.

        Raises:
            InputError: the FMU doesn't provide derivatives of that order.
            SlaveError: the FMU fails.
        """
        if not 0 <= order <= self.highest_order:
            raise InputError(f"this trajectory has derivatives of orders 0 to {self.highest_order}, got order {order}")
        # the FMU runs forward through the different times, in ascending order
        times = np.atleast_1d(np.asarray(time, dtype=np.float64))
        instants, place = np.unique(times, return_inverse=True)
        signals = self._signals(instants, side)
        result: RealArray = signals[: order + 1][:, place.ravel()]
        return result

    def _signals(self, instants: RealArray, side: Side) -> RealArray:
        """Return value and all derivatives (highest_order + 1, N, axes) at ascending times."""
        fmu, axes = self._runs[side], self.axes
        signals = np.zeros((self.highest_order + 1, instants.size, axes))
        values, derivatives = np.empty(KINDS * axes), np.empty((fmu.max_output_order, axes))
        if instants.size == 0:
            return signals
        fmu.initialize(float(instants[0]), float(instants[-1]) + 1.0, None)
        try:
            # at each instant position, velocity, acceleration, then the derivatives of the acceleration
            for n, instant in enumerate(instants.tolist()):
                if n:
                    fmu.step(float(instants[n - 1]), instant - float(instants[n - 1]))
                fmu.get(self._outputs, values)
                fmu.get_derivatives(self._outputs[-axes:], derivatives)
                signals[:KINDS, n] = values.reshape(KINDS, axes)
                signals[KINDS:, n] = derivatives
        finally:
            fmu.terminate()
        return signals
