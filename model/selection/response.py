"""The response of a linear system whose matrices vary in time, M x'' + C x' + K x = f, at the instants of a motion; and the grid of these
instants, with both sides of every jump.

Generalised-α method in the form that satisfies the equations of motion at the instants: second order, unconditionally
stable, with numerical damping of frequencies that the step doesn't resolve. Source: Arnold and Brüls, Convergence of
the generalized-α scheme for constrained mechanical systems, Multibody System Dynamics 18 (2007), eqs. (2) to (4).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import Trajectory

STEPS, LONGEST_STEP, MOST_STEPS = 3000, 5e-4, 12_000
"""Steps over motion and dwell: 0.15 ms for 0.45 s, about 1/20 of a period at 300 Hz. Longest step [s]: 1/20 of a period
at 100 Hz. Largest number of steps, which prevails over the longest step."""


@dataclass(frozen=True, eq=False)
class MotionGrid:
    """A motion and its dwell at N instants, equally spaced between two jumps.

    Attributes:
        time: instants [s], shape (N,); a jump has two instants.
        joints: motor motion u = [q_a, v_a, a_a], shape (N, 6).
        rests: u at standstill before and after the motion, shape (2, 6).
        spans: (first index, last index + 1) of the instants between two jumps.
        duration: duration of the motion, without the dwell [s].
    """

    time: RealArray
    joints: RealArray
    rests: RealArray
    spans: tuple[tuple[int, int], ...]
    duration: float

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Mask of the instants of the motion, shape (N,); the others belong to the dwell."""
        dwelling = np.zeros(self.time.size, dtype=bool)
        if self.time[-1] > self.duration:
            dwelling[self.spans[-1][0] :] = True
        return ~dwelling

    @property
    def steps(self) -> RealArray:
        """Step size of each span [s]."""
        return np.array([(self.time[b - 1] - self.time[a]) / (b - a - 1) for a, b in self.spans])


def motion_grid(motion: Trajectory, dwell: float) -> MotionGrid:
    """The grid of a motion followed by a dwell [s]."""
    # equal steps between breakpoints; the last instant of a span has the values left of the jump
    bounds = [*motion.breakpoints, *([motion.duration + dwell] if dwell else [])]
    step = max(min(bounds[-1] / STEPS, LONGEST_STEP), bounds[-1] / MOST_STEPS)
    times, joints, spans, start = [], [], [], 0
    for a, b in pairwise(bounds):
        time = np.linspace(a, b, max(int(np.ceil((b - a) / step)), 2) + 1)
        u = motion.evaluate(time, 2, "right")
        u[:, -1] = motion.evaluate(time[-1:], 2, "left")[:, 0]
        times.append(time)
        joints.append(np.concatenate([u[0], u[1], u[2]], axis=1))
        spans.append((start, start + time.size))
        start += time.size
    # standstill before and after
    ends = [motion.evaluate(np.array([0.0]), 2, "left"), motion.evaluate(np.array([motion.duration]), 2, "right")]
    rests = np.concatenate(ends, axis=1).transpose(1, 0, 2).reshape(2, 6)
    return MotionGrid(np.concatenate(times), np.concatenate(joints), rests, tuple(spans), motion.duration)


SPECTRAL_RADIUS = 0.8
"""Spectral radius at infinite frequency: little numerical damping of resolved frequencies."""

_ALPHA_M = (2 * SPECTRAL_RADIUS - 1) / (SPECTRAL_RADIUS + 1)
_ALPHA_F = SPECTRAL_RADIUS / (SPECTRAL_RADIUS + 1)
_GAMMA = 0.5 + _ALPHA_F - _ALPHA_M
_BETA = 0.25 * (_GAMMA + 0.5) ** 2
_NEW = (1 - _ALPHA_F) / (1 - _ALPHA_M)
"""Share of the new acceleration in the auxiliary acceleration."""


@dataclass(frozen=True, eq=False)
class ElasticMotion:
    """Elastic coordinates, rates and accelerations at N instants, each (N, n)."""

    position: RealArray
    velocity: RealArray
    acceleration: RealArray

    def __add__(self, other: ElasticMotion) -> ElasticMotion:
        return ElasticMotion(
            self.position + other.position, self.velocity + other.velocity, self.acceleration + other.acceleration
        )


@dataclass(frozen=True, eq=False)
class LinearTimeVaryingSystem:
    """A linear time-varying system: matrices at N instants, each (N, n, n).

    Attributes:
        mass, damping, stiffness: M, C and K.
        spans: (first index, last index + 1) of the instants between two jumps.
        steps: step size of each span [s].
    """

    mass: RealArray
    damping: RealArray
    stiffness: RealArray
    spans: tuple[tuple[int, int], ...]
    steps: RealArray

    def restricted(self, kept: NDArray[np.intp]) -> LinearTimeVaryingSystem:
        """The subsystem of the coordinates `kept`."""
        count, n, _ = self.mass.shape
        # one index into each flat matrix is far quicker than three
        pick = (n * kept[:, None] + kept).ravel()
        mass, damping, stiffness = (
            matrices.reshape(count, n * n).take(pick, axis=1).reshape(count, kept.size, kept.size)
            for matrices in (self.mass, self.damping, self.stiffness)
        )
        return LinearTimeVaryingSystem(mass, damping, stiffness, self.spans, self.steps)

    def response(self, load: RealArray, start: RealArray) -> ElasticMotion:
        """The response to the load f (N, n) from rest at `start` (n,); positions and rates are continuous."""
        count, n = load.shape
        motion = ElasticMotion(*(np.zeros((count, n)) for _ in range(3)))
        if not n:
            return motion
        position, velocity = start, np.zeros(n)
        for (a, b), step in zip(self.spans, self.steps, strict=True):
            self._cross(motion, load, a, b, step, position, velocity)
            position, velocity = motion.position[b - 1], motion.velocity[b - 1]
        return motion

    def _cross(
        self, motion: ElasticMotion, load: RealArray, a: int, b: int, h: float, position: RealArray, velocity: RealArray
    ) -> None:
        """Compute the instants a..b-1 of a motion from position and rate at instant a."""
        # the new acceleration as a linear function of the predicted position and rate, for all instants at once
        mass, damping, stiffness = self.mass[a:b], self.damping[a:b], self.stiffness[a:b]
        q, v, n = h * h * _BETA * _NEW, h * _GAMMA * _NEW, position.size
        inverse = np.linalg.inv(mass + v * damping + q * stiffness)
        gain = -inverse @ np.concatenate([stiffness, damping], axis=2)
        push = np.einsum("kij,kj->ki", inverse, load[a:b])
        # start: acceleration from the equations of motion
        x = np.zeros((4, n))  # position, rate, acceleration, auxiliary acceleration
        x[0], x[1] = position, velocity
        x[2] = x[3] = np.linalg.solve(mass[0], load[a] - damping[0] @ velocity - stiffness[0] @ position)
        result = np.empty((b - a, 4, n))
        result[0] = x
        # step by step: predict, then correct with the new acceleration
        predict, correct = _predictor(h), np.array([q, v, 1.0, _NEW])[:, None]
        for k in range(1, b - a):
            x = predict @ x
            x = x + correct * (push[k] + gain[k] @ x[:2].ravel())
            result[k] = x
        motion.position[a:b], motion.velocity[a:b], motion.acceleration[a:b] = result[:, 0], result[:, 1], result[:, 2]


def _predictor(h: float) -> RealArray:
    """Matrix (4, 4) that predicts the next instant without its new acceleration."""
    # predicted auxiliary and old acceleration, as rows over the state of `_cross`
    auxiliary = np.array([0.0, 0.0, _ALPHA_F, -_ALPHA_M]) / (1 - _ALPHA_M)
    old = np.array([0.0, 0.0, 0.0, 1.0])
    return np.array(
        [
            np.array([1.0, h, 0.0, 0.0]) + h * h * ((0.5 - _BETA) * old + _BETA * auxiliary),
            np.array([0.0, 1.0, 0.0, 0.0]) + h * ((1 - _GAMMA) * old + _GAMMA * auxiliary),
            np.zeros(4),
            auxiliary,
        ]
    )
