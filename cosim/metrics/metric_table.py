"""Table of the metrics of a run: name, unit, description and computation of each.

A metric is computed from the solution of a motion, by a recording (`flexfmu.cosim.metrics.metrics`) or by an
estimate (`flexfmu.cosim.design.effects.estimator`): a peak, a root mean square, a final value of a signal, a settling time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from math import degrees, inf, log10, pi
from operator import methodcaller
from typing import Any

from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.experiment.metric import Metric, printed
from flexfmu.cosim.metrics.signals import ACCELERATION, FIRST_BENDING, JOINT_POSITIONS, POSITION, VELOCITY


@dataclass(frozen=True)
class MetricDefinition:
    """What a metric is: label, unit, description and computation.

    Attributes:
        label: short name for tables.
        unit: SI unit of the value, as in files.
        description: one sentence.
        how: method of the solution and its arguments, joint or leg, and the reduction of the signal that it returns with arguments;
            without a reduction it returns the value.
        columns: recorded signals that it is computed from, whose magnitude bounds its rounding error.
        display: unit in tables and function from the SI unit to it; None for what the unit has in all tables.
    """

    label: str
    unit: str
    description: str
    how: tuple[str, tuple[int, ...], tuple[Any, ...]] = ("", (), ())
    columns: tuple[str, ...] = POSITION
    display: tuple[str, Callable[[float], float]] | None = None

    def computation(self, solution: Any) -> Metric:
        """Its value from the signals of a motion; none without the signal, or of a solution without a method for it."""
        method, of, reduction = self.how
        found = getattr(solution, method)(*of) if hasattr(solution, method) else None
        if found is None:
            return Metric(None)
        value: Metric = methodcaller(*reduction)(found) if reduction else found
        return value

    @property
    def display_unit(self) -> str:
        """Unit in tables and reports."""
        return shown_unit(_DISPLAY[self.unit][0] if self.display is None else self.display[0])

    def displayed(self, value: float) -> float:
        """The value in the display unit."""
        return _DISPLAY[self.unit][1] * value if self.display is None else self.display[1](value)

    @property
    def negligible(self) -> float:
        """Error in the SI unit that never causes a warning, far below what can be measured."""
        return _DISPLAY[self.unit][2]


_DISPLAY: Mapping[str, tuple[str, float, float]] = {
    "m": ("mm", 1e3, 1e-12),
    "m/s": ("m/s", 1.0, 1e-9),
    "m/s2": ("m/s2", 1.0, 1e-5),
    "N.m": ("N.m", 1.0, 1e-9),
    "s": ("s", 1.0, 1e-9),
    "rad": ("mrad", 1e3, 1e-12),
    "rad/s": ("rad/s", 1.0, 1e-9),
    "rad/s2": ("rad/s2", 1.0, 1e-7),
    "rad/s3": ("rad/s3", 1.0, 1e-5),
    "W": ("W", 1.0, 1e-5),
    "J": ("J", 1.0, 1e-6),
    "1": ("1", 1.0, 1e-12),
}
"""SI unit → display unit, factor to it, and negligible error in the SI unit."""


Row = tuple[str, str, str, str, tuple[Any, ...], tuple[str, ...]]
"""Name, label, unit, description, method of the solution with the reduction of its signal, recorded columns; # is the joint or leg."""


def _defined(rows: Iterable[Row], joints: Iterable[int] = (1, 2)) -> dict[str, MetricDefinition]:
    """Return name → metric; of a row with ``#`` one for each joint or leg, in place of it."""
    found = {}
    for name, label, unit, text, how, columns in rows:
        for joint in joints if "#" in name else (0,):
            own, words, sentence, *signals = (each.replace("#", str(joint)) for each in (name, label, text, *columns))
            computed = how[0], (joint,) if joint else (), how[1:]
            found[own] = MetricDefinition(words, unit, sentence, computed, tuple(signals))
    return found


_IN_MOTION = "over the motion, both sides of every jump and t = 0+ included"

# fmt: off
METRICS: Mapping[str, MetricDefinition] = _defined([
    ("peak_torque_#", "Peak torque, joint #", "N.m", f"Largest |torque| of motor # {_IN_MOTION}.",
     ("torque", "peak"), ("joint#.torque",)),
    ("peak_modal_deflection_1", "Modal deflection, link 1", "m",
     "Largest |first bending coordinate| of proximal link 1 over the motion.", ("modal_deflection", "peak"), (FIRST_BENDING,)),
    ("peak_tip_deflection_#", "Tip deflection, link #", "m",
     "Largest |transverse displacement| of the tip of proximal link # over the motion.",
     ("tip_deflection", "peak"), ("link#1.tip_deflection",)),
    ("peak_position_error", "Peak position error", "m",
     "Largest distance from the rigid robot's end effector over motion and dwell.", ("path_error", "peak"), POSITION),
    ("rms_acceleration_error", "RMS acceleration error", "m/s2",
     "Root mean square over the motion of the distance from the rigid acceleration.",
     ("path_error_in_motion", "root_mean_square", 2), ACCELERATION),
    ("end_position_error", "End position error", "m",
     "Distance from the rigid robot's end effector at the end of the motion.", ("path_error_in_motion", "final", 0), POSITION),
    ("end_velocity_error", "End velocity error", "m/s",
     "Norm of the velocity's deviation from the rigid robot's at the end of the motion.",
     ("path_error_in_motion", "final", 1), VELOCITY),
    ("end_acceleration_error", "End acceleration error", "m/s2",
     "Norm of the acceleration's deviation at the end of the motion, before the acceleration's last jump.",
     ("path_error_in_motion", "final", 2), ACCELERATION),
    ("residual_vibration_amplitude", "Residual vibration, peak", "m",
     "Largest distance from the equilibrium at the end pose during the dwell.", ("residual_vibration", "peak"), POSITION),
    ("residual_vibration_rms", "Residual vibration, RMS", "m",
     "Root mean square during the dwell of the distance from that equilibrium.",
     ("residual_vibration", "root_mean_square"), POSITION),
    ("settling_time", "Settling time", "s",
     "Time after the motion's end from which the end effector stays within the settling band around that equilibrium.",
     ("settling_time",), ("time",)),
])

_DUTY: list[Row] = [(f"{name}_#", f"{label}, joint #", unit, f"{what} of motor # over motions and standstills.", how, ("joint#.torque",))
    for name, label, unit, what, how in (
        ("rms_torque", "RMS torque", "N.m", "Root mean square of the torque", ("duty_torque", "root_mean_square")),
        ("peak_speed", "Peak speed", "rad/s", "Largest |angular velocity|", ("duty_speed", "peak")),
        ("rms_speed", "RMS speed", "rad/s", "Root mean square of the angular velocity", ("duty_speed", "root_mean_square")),
        ("peak_power", "Peak power", "W", "Largest power into the robot", ("duty_power", "peak", 1)),
        ("peak_regenerated_power", "Regenerated power", "W", "Largest power from the robot into the shaft",
         ("duty_power", "peak", -1)),
        ("mean_power", "Mean power", "W", "Mean mechanical power", ("duty_power", "mean")),
        ("positive_energy", "Positive energy", "J", "Energy into the robot, a cycle,", ("duty_power", "energy", 1)),
        ("regenerated_energy", "Regenerated energy", "J", "Energy out of the robot, a cycle,", ("duty_power", "energy", -1)),
        ("net_energy", "Net energy", "J", "Positive minus regenerated energy", ("duty_power", "energy", 0)),
    )]

DRIVE_METRICS: Mapping[str, MetricDefinition] = _defined(_DUTY, (1,)) | _defined(_DUTY, (2,))
"""What each motor has to do over the duty cycle; tables show them for scenes with motors."""

MOTOR_METRICS: Mapping[str, MetricDefinition] = _defined([
    ("inertia_ratio_#", "Inertia ratio, joint #", "1",
     "Largest inertia of the load, reflected to the shaft, over that of the rotor of motor #.", ("inertia_ratio",), POSITION),
])
"""Additional metrics of a scene with motors."""

COMMON_METRICS: Mapping[str, MetricDefinition] = {**METRICS, **DRIVE_METRICS}
"""The metrics of every robot."""

LOOP_METRICS: Mapping[str, MetricDefinition] = _defined([
    ("peak_tracking_error_#", "Tracking error, joint #", "rad",
     "Largest |angle of motor # - planned angle| over motion and dwell.", ("tracking_error", "peak"), JOINT_POSITIONS),
    ("rms_tracking_error_#", "RMS tracking error, joint #", "rad",
     "Root mean square over the motion of the angle of motor # - planned angle.",
     ("tracking_error_in_motion", "root_mean_square"), JOINT_POSITIONS),
])
"""Additional metrics of a torque-driven robot."""

ALL_METRICS: Mapping[str, MetricDefinition] = {**COMMON_METRICS, **MOTOR_METRICS, **LOOP_METRICS}
"""The metrics of runs."""

OF_BOTH: Mapping[str, tuple[str, str]] = {
    name.removesuffix("_2"): (f"{name.removesuffix('_2')}_1", name) for name in ALL_METRICS if name.endswith("_2")
}
"""Name of a metric without its joint or leg → those of both."""


def _decibels(value: float) -> float:
    return 20.0 * log10(value) if value > 0.0 else -inf


LOOP_FIGURES: Mapping[str, MetricDefinition] = {
    name: MetricDefinition(label, unit, text, display=(shown, convert))
    for name, label, unit, shown, convert, text in (
        ("gain_margin", "Gain margin", "1", "dB", _decibels,
         "Least factor on the torques above 1 with which the loop is unstable."),
        ("gain_reduction", "Gain reduction", "1", "dB", _decibels,
         "Largest factor on the torques below 1 with which the loop is unstable; 0 if there is none."),
        ("phase_margin", "Phase margin", "rad", "deg", degrees, "Phase lag with which the loop is unstable."),
        ("delay_margin", "Delay margin", "s", "ms", lambda value: 1e3 * value, "Delay with which the loop is unstable."),
        ("disk_margin", "Disk margin", "1", "1", float, "Size of the disk of changes of gain and phase, 0 to 2."),
        ("sensitivity_peak", "Sensitivity peak", "1", "1", float,
         "Largest gain from disturbances to what remains of them."),
        ("bandwidth", "Bandwidth", "rad/s", "Hz", lambda value: 0.5 * value / pi,
         "Lowest frequency at which less than 3 dB of a disturbance are suppressed."),
        ("crossover", "Crossover frequency", "rad/s", "Hz", lambda value: 0.5 * value / pi,
         "Highest frequency at which the loop's gain is 1."),
        ("cpu_time", "Processor time of the simulation", "s", "ms", lambda value: 1e3 * value,
         "Processor time that the simulation took."),
    )
}
"""Figures of a loop beside the metrics of its run: the worst margins along the path, and what it costs."""

# fmt: on

PLAN_FIGURES: Mapping[str, MetricDefinition] = {
    "time": MetricDefinition("Total time", "s", "Duration with shapers, without the dwell."),
    "residual": MetricDefinition(
        "Residual vibration", "m", "Largest distance from rest.", display=("µm", lambda value: 1e6 * value)
    ),
    "torque": MetricDefinition("Peak torque", "N.m", "Largest torque of a motor."),
    "rms_torque": MetricDefinition("RMS torque", "N.m", "Largest RMS torque of a motor, over motion and standstill."),
    "power": MetricDefinition("Power of a motor", "W", "Largest power of a motor, into the robot or back."),
    "supply_power": MetricDefinition("Power of the supply", "W", "Largest power of both motors together."),
    "regenerated_power": MetricDefinition("Power back", "W", "Largest power out of both motors together."),
    "energy": MetricDefinition("Energy", "J", "Energy that the motors give, without what they take back."),
    "off_path": MetricDefinition("Off the path", "m", "Largest distance from the given path."),
    "speed": MetricDefinition("Joint speed", "rad/s", "Largest speed of a joint reference."),
    "acceleration": MetricDefinition("Joint acceleration", "rad/s2", "Largest acceleration of a joint reference."),
    "jerk": MetricDefinition("Joint jerk", "rad/s3", "Largest jerk of a joint reference."),
    "clearance": MetricDefinition("Distance to the keep-out region", "m", "Smallest distance to the keep-out region."),
}
"""Figures of a planned motion, the largest of all robots and joints."""

_LARGER = {
    name: replace(ALL_METRICS[first], label=re.sub(r"(\w+) 1$", r"larger of both \1s", ALL_METRICS[first].label))
    for name, (first, _) in OF_BOTH.items()
}
_EVERY = {**_LARGER, **PLAN_FIGURES, **LOOP_FIGURES, **ALL_METRICS}


def metric(name: str, value: float | None, **known: Any) -> Metric:
    """Return a metric by name, with unit, label and description.

    Args:
        name: of `ALL_METRICS`, `LOOP_FIGURES` or `PLAN_FIGURES`.
        value: in the SI unit, or a metric without name and unit.
        known: further arguments of `Metric`, ``error`` for example.
    """
    info = definition(name)
    what = {"unit": info.unit, "name": name, "label": info.label, "description": info.description, **known}
    return value.changed(**what) if isinstance(value, Metric) else Metric(value, **what)


def definition(name: str) -> MetricDefinition:
    """Return what a metric of `ALL_METRICS` or `OF_BOTH`, or a figure of `LOOP_FIGURES` or `PLAN_FIGURES` is.

    Raises:
        KeyError: there is none of this name.
    """
    return _EVERY[name]


def larger(name: str, values: Mapping[str, float | None]) -> str:
    """Return the name of the metric, of `OF_BOTH` that of the joint or leg with the larger value."""
    return max(OF_BOTH.get(name, (name,)), key=lambda each: max(0.0, values.get(each) or 0.0))


def without_noise(name: str, value: float | None) -> float | None:
    """A metric's value, but 0 for a length that is rounding of the run's coordinates."""
    info = definition(name)
    return 0.0 if value is not None and info.unit == "m" and abs(value) < info.negligible else value


def display(name: str, value: float | None, digits: int | None = None, error: float | None = None) -> str:
    """Format a metric's value in its display unit, see `printed`; a dash where there is none.

    Args:
        name: of the metric, as in ``summary.json``.
        value: in the metric's SI unit; None or NaN where the run doesn't have it.
        digits: largest number of significant digits; None for as many as the error allows, 10 at most, and 6 without an error.
        error: in the same unit; None where it isn't known.

    Raises:
        KeyError: there is no such metric.
    """
    text, _ = _printed(name, value, error, digits)
    return text if text == "–" else f"{text} {definition(name).display_unit}".rstrip()


def display_error(name: str, value: float | None, error: float | None) -> str:
    """Format the bound of a metric's numerical error, in its display unit like `display`: ``1e-6``; empty where unknown."""
    return _printed(name, value, error)[1]


def _printed(name: str, value: float | None, error: float | None, digits: int | None = None) -> tuple[str, str]:
    # an error is a small change of the value
    shown = definition(name).displayed
    return printed(None if value is None else shown(value), None if error is None else shown(error), digits)
