"""The instants at which a motion is evaluated, with both sides of every jump."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from flexfmu.trajectories.jets import RealArray

STEPS, LONGEST_STEP, MOST_STEPS = 3000, 5e-4, 12_000
"""Steps over motion and dwell, 0.15 ms for 0.45 s, a 20th of a period at 300 Hz; the longest step [s], a 20th at 100 Hz; and how many
steps at most."""


class JointMotion(Protocol):
    """A planned motion of the two motors; `flexfmu.trajectories` has them."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        ...

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which some derivative may jump, sorted, 0 and the duration included."""
        ...

    def evaluate(self, time: RealArray, order: int = 2, side: Literal["left", "right"] = "right") -> RealArray:
        """Angles [rad] and their time derivatives, shape (order + 1, N, 2)."""
        ...


@dataclass(frozen=True, eq=False)
class MotionGrid:
    """A motion and its dwell at N instants; between two jumps they are equally spaced.

    Attributes:
        time: [s], shape (N,); the time of a jump appears twice.
        joints: u = [q_a, v_a, a_a] of the motors, shape (N, 6).
        rests: the standstill before the motion and that after it, shape (2, 6).
        spans: first and last index + 1 of the instants between two jumps.
        duration: of the motion, without the dwell [s].
    """

    time: RealArray
    joints: RealArray
    rests: RealArray
    spans: tuple[tuple[int, int], ...]
    duration: float

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Instants of the motion; the others belong to the dwell, shape (N,)."""
        dwelling = np.zeros(self.time.size, dtype=bool)
        if self.time[-1] > self.duration:
            dwelling[self.spans[-1][0] :] = True
        return ~dwelling

    @property
    def steps(self) -> RealArray:
        """Step of each span [s]."""
        return np.array([(self.time[b - 1] - self.time[a]) / (b - a - 1) for a, b in self.spans])


def motion_grid(motion: JointMotion, dwell: float) -> MotionGrid:
    """The instants of a motion with a standstill of `dwell` [s] after it."""
    # equal steps between breakpoints; the last instant of each span takes the left side of its jump
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
