"""Joint trajectories through the mechanism's inverse kinematics, checked along the whole path while planning.

Inverse kinematics gives angles modulo 2π. Unwrapped samples along the path determine the multiple of 2π at every instant.
Margins are evaluated at the same samples. Around each local minimum the grid is refined until the margin can no longer fall
below its required value, or the minimum is located to rounding.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.errors import TrajectoryError, times
from flexfmu.trajectories.jets import Jet, RealArray, checked_order
from flexfmu.trajectories.trajectory import HasLimits, Trajectory, limits, sampled_positions

LARGEST_TURN = 1.0
"""Largest rotation of a joint between two samples [rad], far below π, where unwrapping becomes ambiguous. Samples are added where a
joint turns further, as happens near a base."""

REFINEMENTS = 24
"""Rounds of refinement; in each the neighbourhood of a minimum shrinks to a quarter. The time of the minimum is then exact to 1e-14
of the interval, and the error of the margin is below its rounding."""


STANDSTILL = 1e-9
"""Fraction of the duration after the end of a motion from which both limits are standstill."""


@dataclass(frozen=True, eq=False)
class Margin:
    """A measure of the distance from a workspace boundary or a singularity, at N positions.

    Attributes:
        name: name of the measure, for messages.
        unit: unit of the values.
        values: margin at each position, shape (N,); NaN, for an undefined margin, counts as a violation.
        required: smallest admissible value.
    """

    name: str
    unit: str
    values: RealArray
    required: float


class InverseKinematics(Protocol):
    """Inverse kinematics and safety margins of a mechanism."""

    def joints(self, x: Jet, y: Jet) -> tuple[Jet, Jet]:
        """Return jets of q11 and q21 [rad], modulo 2π, from jets of the end effector's x and y [m]."""

    def margins(self, position: RealArray) -> tuple[Margin, ...]:
        """Return all margins at end-effector positions (N, 2) [m], which may be outside the workspace."""


@dataclass(frozen=True)
class JointTrajectory(HasLimits):
    """Joint angles q11 and q21 [rad] of a motion of the end effector, continuous in time (without jumps of 2π).

    The constructor checks the margins along the whole path.

    Attributes:
        task: motion of the end effector, x and y [m].
        kinematics: the mechanism's inverse kinematics.

    Raises:
        TrajectoryError: the path leaves the workspace or comes too close to a singularity.
    """

    task: Trajectory
    kinematics: InverseKinematics
    coordinates: ClassVar = "joints"

    def __post_init__(self) -> None:
        check_margins(self.task, self.kinematics, self._first_samples)

    def timed(self, task: Trajectory) -> JointTrajectory:
        """Return the joint trajectory of ``task``, the same motion with another duration: its margins are known."""
        other, (time, angles) = copy(self), self._samples
        object.__setattr__(other, "task", task)
        other.__dict__.pop("_first_samples", None)
        other.__dict__["_samples"] = time * (task.duration / self.duration), angles
        return other

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.task.duration

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which a derivative may jump: the breakpoints of ``task``."""
        return self.task.breakpoints

    def limits(self, time: ArrayLike, left: NDArray[np.bool_], order: int) -> RealArray:
        """See `flexfmu.trajectories.trajectory.HasLimits`."""
        time = times(time)
        # standstill after the motion: one instant stands for all
        late = np.flatnonzero(time > self.duration * (1.0 + STANDSTILL))
        if late.size > 1:
            first, others = late[0], np.delete(np.arange(time.size), late[1:])
            result = np.empty((order + 1, time.size, 2))
            result[:, others] = self.limits(time[others], left[others], order)
            result[:, late] = result[:, [first]]
            return result
        # inverse kinematics of the series in time
        motion = Jet.from_derivatives(limits(self.task, time, left, checked_order(order)))
        x, y = (Jet(motion.coefficients[:, :, i]) for i in (0, 1))
        result = np.stack([joint.derivatives() for joint in self.kinematics.joints(x, y)], axis=-1)
        # add the multiple of 2π that is nearest to the interpolated samples
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
            # add samples where a joint turns too far between two of them to be unwrapped reliably
            wide = np.flatnonzero(np.max(np.abs(np.diff(angles, axis=0)), axis=1) > LARGEST_TURN)
            if not wide.size:
                break
            time = np.insert(time, wide + 1, 0.5 * (time[wide] + time[wide + 1]))
            positions = np.asarray(self.task.evaluate(time, 0)[0])
        return time, angles


class ForwardKinematics(Protocol):
    """Forward kinematics of a mechanism."""

    def end_effector(self, q11: Jet, q21: Jet) -> tuple[Jet, Jet]:
        """Return jets of the end effector's x and y [m] from jets of the joint angles [rad]."""


@dataclass(frozen=True)
class EndEffectorTrajectory:
    """Motion of the rigid end effector, x and y [m], from the motion of the joints by forward kinematics.

    Attributes:
        joints: motion of the joints, q11 and q21 [rad].
        kinematics: the mechanism's forward kinematics.
    """

    joints: Trajectory
    kinematics: ForwardKinematics

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.joints.duration

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which a derivative may jump: the breakpoints of ``joints``."""
        return self.joints.breakpoints

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return x and y [m] and their time derivatives, (order + 1, N, 2); see `flexfmu.trajectories.Trajectory.evaluate`."""
        # forward kinematics of the series in time
        motion = Jet.from_derivatives(self.joints.evaluate(time, checked_order(order), side))
        q11, q21 = (Jet(motion.coefficients[:, :, i]) for i in (0, 1))
        return np.stack([jet.derivatives() for jet in self.kinematics.end_effector(q11, q21)], axis=-1)


def check_margins(
    task: Trajectory, kinematics: InverseKinematics, samples: tuple[RealArray, RealArray] | None = None
) -> None:
    """Check that no margin falls below its required value during a motion.

    Args:
        task: motion of the end effector.
        kinematics: the mechanism's inverse kinematics.
        samples: result of `sampled_positions` for the motion, if it is known already.

    Raises:
        TrajectoryError: a margin is too small; the message has its name, smallest value, time, position and required value.
    """
    # all violated margins, each with its minimum
    time, positions = sampled_positions(task) if samples is None else samples
    violations = []
    for index, margin in enumerate(kinematics.margins(positions)):
        worst_time, worst = _smallest(task, kinematics, index, time, margin.values, margin.required)
        if worst < margin.required:
            violations.append((not np.isfinite(worst), index, margin, worst_time, worst))
    if not violations:
        return
    # report finite margins first, since they are the cause of undefined ones
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
    """Return time [s] and value of the minimum of margin number ``index``, refined around the local minima of the samples.

    Near a minimum the margin is convex: between two samples it falls by less than it rises at the neighbouring ones. If that rise
    is smaller than the distance to ``required``, the margin can't fall below it, and refinement ends.
    """

    def defined(margins: RealArray) -> RealArray:
        return np.where(np.isnan(margins), -np.inf, margins)

    # local minima of the samples, each with its neighbours; an undefined margin counts as -infinity
    values = defined(values)
    padded = np.concatenate([[np.inf], values, [np.inf]])
    minima = np.flatnonzero((values <= padded[:-2]) & (values < padded[2:]))
    low, high = time[np.maximum(minima - 1, 0)], time[np.minimum(minima + 1, len(time) - 1)]
    best = time[minima], values[minima]
    # no refinement where the margin rises by less within two samples than its distance to the required value
    around = values[np.clip(minima + np.arange(-2, 3)[:, None], 0, len(values) - 1)]
    with np.errstate(invalid="ignore"):
        is_far = np.all(np.max(around, axis=0) - best[1] < best[1] - required)
    for _ in range(0 if is_far else REFINEMENTS):
        # nine points in each neighbourhood, for all minima at once
        grid = low + (high - low) * np.linspace(0.0, 1.0, 9)[:, None]
        positions = task.evaluate(grid.ravel(), 0)[0]
        found = defined(kinematics.margins(positions)[index].values).reshape(grid.shape)
        at = np.argmin(found, axis=0), np.arange(len(minima))
        best = grid[at], found[at]
        with np.errstate(invalid="ignore"):
            spread = np.max(found, axis=0) - best[1]
        if np.all(spread < best[1] - required):
            break
        # shrink each neighbourhood to a quarter, around its smallest margin
        quarter = 0.125 * (high - low)
        low, high = np.maximum(low, best[0] - quarter), np.minimum(high, best[0] + quarter)
    worst = int(np.argmin(best[1]))
    return float(best[0][worst]), float(best[1][worst])
