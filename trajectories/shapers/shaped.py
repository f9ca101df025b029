"""Shaped trajectories: a motion convolved with an impulse sequence, evaluated exactly at t - T_i."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.checks import times
from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.jets import RealArray, checked_order
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.trajectory import SAME_TIME, Trajectory


@dataclass(frozen=True)
class ShapedTrajectory:
    """Σ A_i q(t - T_i) for a motion q: on joint references it moves the end effector off its path a little.

    Attributes:
        trajectory: the motion q.
        sequence: impulses A_i at T_i.
    """

    trajectory: Trajectory
    sequence: ImpulseSequence

    @property
    def duration(self) -> float:
        """Duration of the motion [s]: that of q and of the sequence."""
        return self.trajectory.duration + self.sequence.duration

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which some derivative may jump: those of q, shifted by every impulse."""
        shifted = [point + delay for delay in self.sequence.times for point in self.trajectory.breakpoints]
        return merged([0.0, self.duration], shifted, 0.5 * SAME_TIME * self.trajectory.duration)

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Coordinates and their time derivatives; see `flexfmu.trajectories.Trajectory.evaluate`."""
        delayed = times(time) - np.array(self.sequence.times)[:, np.newaxis]
        parts = self.trajectory.evaluate(delayed.ravel(), checked_order(order), side)
        parts = parts.reshape(order + 1, *delayed.shape, parts.shape[-1])
        return np.asarray(np.einsum("i,kinc->knc", np.array(self.sequence.amplitudes), parts))


def merged(kept: list[float], others: list[float], near: float) -> tuple[float, ...]:
    """Times, ascending: the kept ones, and of the others those that are not within ``near`` of one named before."""
    found = list(kept)
    for time in others:
        if min(abs(time - other) for other in found) > near:
            found.append(time)
    return tuple(sorted(found))
