"""Signals of a recording as Hermite segments for metrics and plots, and the tracking error of each cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import COINCIDENT, RealArray
from flexfmu.cosim.metrics.segments import HermiteSegments
from flexfmu.trajectories.trajectory import limits

if TYPE_CHECKING:
    from flexfmu.cosim.experiment.planning import MotionPlan
    from flexfmu.trajectories.trajectory import Trajectory

POSITION = ("end_effector.position.x", "end_effector.position.y")
VELOCITY = ("end_effector.velocity.x", "end_effector.velocity.y")
ACCELERATION = ("end_effector.acceleration.x", "end_effector.acceleration.y")
JOINT_POSITIONS = ("joint1.position", "joint2.position")
TORQUES = ("joint1.torque", "joint2.torque")
TIP_DEFLECTIONS = ("link11.tip_deflection", "link21.tip_deflection")
FIRST_BENDING = "link11.bending[1]"

ROUNDING = 8.0 * float(np.finfo(float).eps)
"""Rounding error of a metric, relative to the largest magnitude of the signals that it is computed from."""


def segments(recording: Recording, names: Sequence[str], accelerations: Sequence[str] = ()) -> HermiteSegments:
    """Return the named signals, interpolated between communication points, one channel each.

    Args:
        recording: signals with first and second time derivatives.
        names: signals of one unit.
        accelerations: recorded signals that are their second derivatives; with these the derivatives to the fourth
            order are known, and the interpolant has degree 9 instead of 5.

    Raises:
        ResultsError: a signal or its derivatives were not recorded.
    """
    derivatives = _derivatives(recording, [names, accelerations] if accelerations else [names])
    # no segments between both sides of a jump
    time = recording.time
    start = np.flatnonzero(time[1:] > time[:-1])
    end = start + 1
    return HermiteSegments(
        time.take(start), time.take(end), derivatives.take(start, axis=1), derivatives.take(end, axis=1)
    )


def position(recording: Recording) -> HermiteSegments:
    """Return the end-effector position [m] with four derivatives.

    The second derivative of this interpolant of degree 9 is also the best acceleration: where a step spans a period of
    the vibration, the quintic through acceleration, jerk and snap has a thousand times its error.
    """
    return segments(recording, POSITION, ACCELERATION)


def position_rounding(recording: Recording) -> float:
    """Return the rounding error [m] of differences between end-effector positions, see `HermiteSegments.resolving_curvature`."""
    return 8.0 * ROUNDING * max(float(np.abs(recording[name].values).max(initial=0.0)) for name in POSITION)


def deviation_from_rigid(motion: HermiteSegments, task: Trajectory) -> HermiteSegments:
    """Return the deviation of the end effector's position [m] from the rigid robot's, which tracks its path exactly.

    Args:
        motion: end-effector position.
        task: the rigid robot's motion, at standstill after its end.
    """
    return motion.minus(*at_ends(motion, task))


def joint_error(recording: Recording, joint: int, planned: Trajectory) -> HermiteSegments:
    """Return a joint's angle minus its planned angle [rad]; the planned motion is at standstill after its end.

    Args:
        recording: of a robot that is driven by torques.
        joint: 0 or 1.
        planned: joint trajectory.
    """
    acceleration = JOINT_POSITIONS[joint].replace("position", "acceleration")
    signal = segments(recording, [JOINT_POSITIONS[joint]], [acceleration])
    begin, end = at_ends(signal, planned)
    return signal.minus(begin[..., joint : joint + 1], end[..., joint : joint + 1])


def at_ends(signal: HermiteSegments, planned: Trajectory, order: int | None = None) -> tuple[RealArray, RealArray]:
    """Return the planned motion and its derivatives (m, n, c) at the start and at the end of each segment.

    The derivatives go up to ``order``, without one to the highest of the signal.
    """
    time = np.concatenate([signal.start, signal.end])
    left = np.arange(time.size) >= signal.start.size
    both = limits(planned, time, left, len(signal.left) - 1 if order is None else order)
    return both[:, : signal.start.size], both[:, signal.start.size :]


def deviation_from_point(signal: HermiteSegments, point: RealArray) -> HermiteSegments:
    """Return the deviation of a position from a fixed ``point`` (2,) [m]."""
    fixed = np.zeros((len(signal.left), 1, len(point)))
    fixed[0] = point
    return signal.minus(fixed, fixed)


def sample(signal: HermiteSegments, per_segment: int, order: int = 0) -> tuple[RealArray, RealArray]:
    """Return times (k,) and values (k, c) of a time derivative for a plot, ``per_segment`` in each segment."""
    theta = np.linspace(0.0, 1.0, per_segment)
    time = signal.start + theta[:, np.newaxis] * signal.duration
    values = signal.evaluate(theta, order)
    return time.T.ravel(), values.transpose(1, 0, 2).reshape(-1, values.shape[2])


def _derivatives(recording: Recording, groups: Sequence[Sequence[str]]) -> RealArray:
    """Return the time derivatives (m, N, c) of signals from order 0 on.

    Args:
        recording: signals with first and second time derivatives.
        groups: the signals, then possibly their second derivatives, so that the derivatives go up to order 4.

    Raises:
        ResultsError: a signal or its derivatives were not recorded.
    """
    found = np.empty((2 * len(groups) + 1, recording.time.size, len(groups[0])))
    for first, names in zip((0, 2), groups, strict=False):
        # one channel for each name
        for channel, name in enumerate(names):
            try:
                column = recording[name]
            except KeyError as error:
                raise ResultsError(f"metrics need the signal `{name}`: {error.args[0]}") from None
            if column.first is None or column.second is None:
                raise ResultsError(
                    f"metrics need the time derivatives of `{name}`, which were not recorded: simulate it anew"
                )
            # the second derivative is known both ways, as such and as the second derivative's value
            for order, values in enumerate((column.values, column.first, column.second), start=first):
                if first == 0 or order > first:
                    found[order, :, channel] = values
    return found


@dataclass(frozen=True)
class CycleError:
    """Tracking error of both joints in one cycle: reference - angle [rad].

    Attributes:
        rms: root mean square over the cycle.
        largest: largest magnitude.
    """

    rms: tuple[float, ...]
    largest: tuple[float, ...]


def cycle_errors(motion: MotionPlan, recording: Recording) -> Sequence[CycleError]:
    """Return the tracking error of each cycle of a repeated motion, which shows the progress of learning.

    Only cycles that were recorded to their end count; the root mean square uses the trapezoidal rule between recorded
    instants. The result is empty for a motion that isn't repeated or without recorded joint angles. The last cycle ends
    with the last standstill.
    """
    if motion.repetition is None or any(name not in recording.columns for name in JOINT_POSITIONS):
        return ()
    # reference - angle (2, N) [rad]
    references = (name.replace("position", "reference.position") for name in JOINT_POSITIONS)
    pairs = zip(references, JOINT_POSITIONS, strict=True)
    error = np.stack([recording[reference].values - recording[angle].values for reference, angle in pairs])
    # cycles that were recorded to their end
    period, time = motion.repetition.period, recording.time
    begins = period * np.arange(motion.repetition.cycles)
    ends = np.minimum(begins + period, motion.stop_time)
    reached = ends <= (time[-1] + COINCIDENT * period if time.size else -np.inf)
    found = []
    for begin, end in zip(begins[reached].tolist(), ends[reached].tolist(), strict=True):
        near = COINCIDENT * (end - begin)
        inside = (time >= begin - near) & (time <= end + near)
        squares = np.trapezoid(error[:, inside] ** 2, time[inside], axis=1)
        rms, largest = np.sqrt(squares / (end - begin)), abs(error[:, inside]).max(axis=1)
        found.append(CycleError(tuple(rms.tolist()), tuple(largest.tolist())))
    return found
