"""Grid of instants of a motion, with both sides of every jump."""

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
