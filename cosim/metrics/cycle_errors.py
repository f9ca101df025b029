"""The tracking error of a repeated motion, cycle by cycle: what learning is judged by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import COINCIDENT, RealArray
from flexfmu.cosim.experiment.planning import MotionPlan

JOINTS = ("joint1", "joint2")


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
    """Errors of the cycles that were recorded to their end, between the recorded instants by the trapezoidal rule.

    Nothing for a motion that isn't repeated, or a robot whose joint angles aren't recorded. The last standstill ends the
    last cycle.
    """
    if motion.repetition is None or any(f"{joint}.position" not in recording.columns for joint in JOINTS):
        return ()
    period, time = motion.repetition.period, recording.time
    error = np.stack([_tracking_error(recording, joint) for joint in JOINTS])
    begins = period * np.arange(motion.repetition.cycles)
    ends = np.minimum(begins + period, motion.stop_time)
    reached = time[-1] + COINCIDENT * period if time.size else -np.inf
    pairs = zip(begins[ends <= reached].tolist(), ends[ends <= reached].tolist(), strict=True)
    return [_between(begin, end, time, error) for begin, end in pairs]


def _tracking_error(recording: Recording, joint: str) -> RealArray:
    """(N,) reference - angle [rad]."""
    reference, angle = recording[f"{joint}.reference.position"], recording[f"{joint}.position"]
    return np.asarray(reference.values - angle.values)


def _between(begin: float, end: float, time: RealArray, error: RealArray) -> CycleError:
    """The error from one instant to another."""
    near = COINCIDENT * (end - begin)
    inside = (time >= begin - near) & (time <= end + near)
    squares = trapezoid(error[:, inside] ** 2, time[inside], axis=1)
    rms, largest = np.sqrt(squares / (end - begin)), abs(error[:, inside]).max(axis=1)
    return CycleError(tuple(rms.tolist()), tuple(largest.tolist()))
