"""Joint trajectories through the mechanism's inverse kinematics, checked along the whole path while planning.

Inverse kinematics gives angles modulo 2π; samples along the path, unwrapped, say which turn each belongs to. A margin is
evaluated at the same samples; around its local minima the grid is refined until the minimum cannot fall below what is
required any more, or its place is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.trajectories.curves import Side, checked_side
from flexfmu.trajectories.errors import TrajectoryError, times
from flexfmu.trajectories.jets import Jet, RealArray, checked_order
from flexfmu.trajectories.trajectory import Trajectory, limits

SAMPLES_PER_INTERVAL = 200
"""Points between two breakpoints at which margins and angles are evaluated first; between two of them a margin has at
most one minimum."""

LARGEST_TURN = 1.0
"""Angle [rad] that a joint may turn between two samples, far below the π at which turns become ambiguous; where it turns
more, next to a base, samples are added."""

REFINEMENTS = 24
"""Rounds in which the neighbourhood of a critical margin shrinks to a quarter: its time is exact to 1e-14 of the
interval, which is below the rounding of the margin itself."""


@dataclass(frozen=True, eq=False)
class Margin:
    """A distance from what a motion must avoid, such as the workspace's boundary or a singularity.

    Attributes:
        name: what is measured, for messages.
        unit: unit of the values.
        values: margin at each position, shape (N,); NaN where it isn't defined counts as a violation.
        required: least admissible value.
    """

    name: str
    unit: str
    values: RealArray
    required: float


class InverseKinematics(Protocol):
    """From the end effector to the actuated joints."""

    def joints(self, x: Jet, y: Jet) -> tuple[Jet, Jet]:
        """Jets of q11 and q21 [rad] from jets of the end effector's x and y [m]; angles modulo 2π."""
        ...

    def margins(self, position: RealArray) -> tuple[Margin, ...]:
        """Margins at positions (x, y) [m], shape (N, 2), inside the workspace and outside."""
        ...


@dataclass(frozen=True)
class JointTrajectory:
    """q11 and q21 [rad] in time, continuous along the path.

    Planning checks the margins along the whole path.

    Attributes:
        task: motion of the end effector, x and y [m].
        kinematics: the mechanism's inverse kinematics.

    Raises:
        TrajectoryError: the path leaves the workspace or comes too near to a singularity.
    """

    task: Trajectory
    kinematics: InverseKinematics

    def __post_init__(self) -> None:
        check_margins(self.task, self.kinematics, self._first_samples)

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.task.duration

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which some derivative may jump: those of the motion of the end effector."""
        return self.task.breakpoints

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """q11 and q21 [rad] and their time derivatives; see `Trajectory.evaluate`."""
        time = times(time)
        return self.limits(time, np.full(time.shape, checked_side(side) == "left"), order)

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `flexfmu.trajectories.trajectory.HasLimits`."""
        time = times(time)
        # inverse kinematics of the series in time
        motion = Jet.from_derivatives(limits(self.task, time, left, checked_order(order)))
        x, y = (Jet(motion.coefficients[:, :, i]) for i in (0, 1))
        result = np.stack([joint.derivatives() for joint in self.kinematics.joints(x, y)], axis=-1)
        # whole turns are added that bring the angles to within π of those between the samples
        sample_times, angles = self._samples
        near = np.stack([np.interp(time, sample_times, angle) for angle in angles.T], axis=-1)
        result[0] = result[0] + 2.0 * np.pi * np.round((near - result[0]) / (2.0 * np.pi))
        return result

    @cached_property
    def _first_samples(self) -> tuple[RealArray, RealArray]:
        """See `sampled_positions`."""
        return sampled_positions(self.task)

    @cached_property
    def _samples(self) -> tuple[RealArray, RealArray]:
        """Sample times [s], shape (N,), and continuous joint angles [rad], shape (N, 2)."""
        time, positions = self._first_samples
        for _ in range(REFINEMENTS):
            joints = self.kinematics.joints(Jet(positions[None, :, 0]), Jet(positions[None, :, 1]))
            angles = np.unwrap(np.stack([joint.value for joint in joints], axis=-1), axis=0)
            # more samples where a joint turns so far between two that the turn is ambiguous
            wide = np.flatnonzero(np.max(np.abs(np.diff(angles, axis=0)), axis=1) > LARGEST_TURN)
            if not wide.size:
                break
            time = np.insert(time, wide + 1, 0.5 * (time[wide] + time[wide + 1]))
            positions = np.asarray(self.task.evaluate(time, 0)[0])
        return time, angles


def sampled_positions(task: Trajectory) -> tuple[RealArray, RealArray]:
    """Times [s], shape (N,), from 0 to the duration with all breakpoints, and positions [m] there, shape (N, 2)."""
    spans = [np.linspace(a, b, SAMPLES_PER_INTERVAL, endpoint=False) for a, b in pairwise(task.breakpoints)]
    time = np.concatenate([*spans, [task.duration]])
    return time, np.asarray(task.evaluate(time, 0)[0])


def check_margins(
    task: Trajectory, kinematics: InverseKinematics, samples: tuple[RealArray, RealArray] | None = None
) -> None:
    """Refuse a motion along which a margin falls below what it requires.

    Args:
        task: motion of the end effector.
        kinematics: the mechanism's inverse kinematics.
        samples: what `sampled_positions` returns for the motion, where that is known.

    Raises:
        TrajectoryError: names the margin, its worst point and time, its value there and what is required.
    """
    # every margin that falls short, with its worst point
    time, positions = sampled_positions(task) if samples is None else samples
    violations = []
    for index, margin in enumerate(kinematics.margins(positions)):
        worst_time, worst = _smallest(task, kinematics, index, time, margin.values, margin.required)
        if worst < margin.required:
            violations.append((not np.isfinite(worst), index, margin, worst_time, worst))
    if not violations:
        return
    # margins with a value first: an undefined one follows from them
    _, _, margin, worst_time, worst = min(violations, key=lambda violation: violation[:2])
    unit = "" if margin.unit in ("", "1") else f" {margin.unit}"
    found = f"{worst:.6g}{unit}" if np.isfinite(worst) else "undefined"
    x, y = task.evaluate(worst_time, 0)[0, 0]
    raise TrajectoryError(
        f"{margin.name} is {found} at (x, y) = ({x:.6g}, {y:.6g}) m, t = {worst_time:.6g} s; "
        f"it must be at least {margin.required:.6g}{unit} along the whole path: move the path or change the mechanism"
    )


def _smallest(
    task: Trajectory, kinematics: InverseKinematics, index: int, time: RealArray, values: RealArray, required: float
) -> tuple[float, float]:
    """Time [s] and value of the smallest margin number ``index``, refined around the samples' local minima.

    Around a minimum a convex margin rises by more than it may still fall between the samples; where that is less
    than what is left above ``required``, it won't get there.
    """

    def defined(margins: RealArray) -> RealArray:
        return np.where(np.isnan(margins), -np.inf, margins)

    # local minima of the samples, each with its neighbours; undefined is the smallest of all
    values = defined(values)
    padded = np.concatenate([[np.inf], values, [np.inf]])
    minima = np.flatnonzero((values <= padded[:-2]) & (values < padded[2:]))
    low, high = time[np.maximum(minima - 1, 0)], time[np.minimum(minima + 1, len(time) - 1)]
    best = time[minima], values[minima]
    # no refinement where two samples on either side rise by less than what is left
    around = values[np.clip(minima + np.arange(-2, 3)[:, None], 0, len(values) - 1)]
    with np.errstate(invalid="ignore"):
        is_far = np.all(np.max(around, axis=0) - best[1] < best[1] - required)
    for _ in range(0 if is_far else REFINEMENTS):
        # nine points in each neighbourhood, all minima at once
        grid = low + (high - low) * np.linspace(0.0, 1.0, 9)[:, None]
        positions = task.evaluate(grid.ravel(), 0)[0]
        found = defined(kinematics.margins(positions)[index].values).reshape(grid.shape)
        at = np.argmin(found, axis=0), np.arange(len(minima))
        best = grid[at], found[at]
        with np.errstate(invalid="ignore"):
            spread = np.max(found, axis=0) - best[1]
        if np.all(spread < best[1] - required):
            break
        # the neighbourhood shrinks to a quarter around the smallest
        quarter = 0.125 * (high - low)
        low, high = np.maximum(low, best[0] - quarter), np.minimum(high, best[0] + quarter)
    worst = int(np.argmin(best[1]))
    return float(best[0][worst]), float(best[1][worst])
