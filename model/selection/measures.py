"""What is measured of a motion in order to compare sets of effects, and against what an error is relative."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from flexfmu.model.scene.choice import MeasureName
from flexfmu.model.selection.linearized_motion import Outputs
from flexfmu.model.selection.motion_grid import MotionGrid
from flexfmu.trajectories.jets import RealArray

FLOOR, ASKED_FLOOR = 0.1, 1e-4
"""Where a metric is near zero, errors are relative to this fraction of the largest deviation that elasticity causes; the second one
holds where the user asked for the metric: what is smaller, no run resolves."""


@dataclass(frozen=True, eq=False)
class Behaviour:
    """What a set of effects makes of a motion.

    Attributes:
        grid: the instants.
        outputs: what the robot does at them.
        rigid: what it would do if it were rigid.
        rest: end effector at the end pose's static equilibrium, (2,) [m].
    """

    grid: MotionGrid
    outputs: Outputs
    rigid: Outputs
    rest: RealArray

    def deviation(self) -> RealArray:
        """Distance of the end effector from the rigid robot's [m], shape (N,)."""
        return np.asarray(np.linalg.norm(self.outputs.position - self.rigid.position, axis=1))

    def vibration(self) -> RealArray:
        """Distance of the end effector from its equilibrium during the dwell [m]."""
        return np.asarray(np.linalg.norm(self.outputs.position[~self.grid.moving] - self.rest, axis=1))


def measure_behaviour(behaviour: Behaviour, of: Iterable[MeasureName]) -> dict[MeasureName, float]:
    """Metrics of a motion in SI units; as `flexfmu.cosim.metrics.metrics` defines them, but from the instants alone."""
    return {name: _MEASURES[name](behaviour) for name in of}


def scales(reference: Mapping[MeasureName, float], asked: Collection[MeasureName] = ()) -> dict[MeasureName, float]:
    """What errors of each metric are relative to, in the metric's unit.

    This is the metric itself, but for positions at least `FLOOR` times the peak position error, which must be among the
    metrics of the reference: a residual vibration that has died out is no scale for anything.

    Args:
        reference: metrics of the richest set.
        asked: metrics that the user named, which are judged relative to themselves (down to `ASKED_FLOOR`).
    """
    peak = reference["peak_position_error"]
    floors = {name: peak * (ASKED_FLOOR if name in asked else FLOOR) for name in reference if name in _POSITIONS}
    return {name: max(abs(value), floors.get(name, 0.0)) for name, value in reference.items()}


def _peak_torque(joint: int) -> Callable[[Behaviour], float]:
    return lambda b: float(np.abs(b.outputs.torque[b.grid.moving, joint]).max())


def _peak_position_error(b: Behaviour) -> float:
    return float(b.deviation().max())


def _end_position_error(b: Behaviour) -> float:
    return float(b.deviation()[b.grid.moving][-1])


def _rms_acceleration_error(b: Behaviour) -> float:
    squares = np.sum((b.outputs.acceleration - b.rigid.acceleration) ** 2, axis=1)[b.grid.moving]
    return float(np.sqrt(trapezoid(squares, b.grid.time[b.grid.moving]) / b.grid.duration))


def _residual_amplitude(b: Behaviour) -> float:
    return float(b.vibration().max())


def _residual_rms(b: Behaviour) -> float:
    time = b.grid.time[~b.grid.moving]
    return float(np.sqrt(trapezoid(b.vibration() ** 2, time) / (time[-1] - time[0])))


_MEASURES: Mapping[MeasureName, Callable[[Behaviour], float]] = {
    "peak_torque_1": _peak_torque(0),
    "peak_torque_2": _peak_torque(1),
    "peak_position_error": _peak_position_error,
    "rms_acceleration_error": _rms_acceleration_error,
    "end_position_error": _end_position_error,
    "residual_vibration_amplitude": _residual_amplitude,
    "residual_vibration_rms": _residual_rms,
}

_POSITIONS = {
    "peak_position_error",
    "end_position_error",
    "residual_vibration_amplitude",
    "residual_vibration_rms",
}
