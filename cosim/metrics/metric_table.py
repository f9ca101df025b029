"""Table of the metrics of a run: name, unit, description and computation of each.

A metric is a function of a `Solution`, the signals of a motion from a recording (`flexfmu.cosim.metrics.metrics`) or
from an estimate (`flexfmu.cosim.design.effects.estimator`): a peak, a root mean square, a final value or a settling
time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import degrees, inf, log10, pi
from operator import methodcaller
from typing import Any

from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.experiment.metric import Metric, printed
from flexfmu.cosim.metrics.signals import (
    ACCELERATION,
    FIRST_BENDING,
    JOINT_POSITIONS,
    POSITION,
    TIP_DEFLECTIONS,
    TORQUES,
    VELOCITY,
)
from flexfmu.cosim.metrics.solution import Solution, TimeSignal

Computation = Callable[[Solution], Metric]
"""Signals of a motion → value of a metric."""


@dataclass(frozen=True)
class MetricDefinition:
    """What a metric is: label, unit, description and computation.

    Attributes:
        label: short name for tables.
        unit: SI unit of the value, as in files.
        description: one sentence.
        computation: its value from the signals of a motion.
        columns: recorded signals that it is computed from, whose magnitude bounds its rounding error.
        display: unit in tables and function from the SI unit to it; None for what the unit has in all tables.
    """

    label: str
    unit: str
    description: str
    computation: Computation = lambda solution: Metric(None)
    columns: tuple[str, ...] = POSITION
    display: tuple[str, Callable[[float], float]] | None = None

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
    "W": ("W", 1.0, 1e-5),
    "J": ("J", 1.0, 1e-6),
    "1": ("1", 1.0, 1e-12),
}
"""SI unit → display unit, factor to it, and negligible error in the SI unit."""


def _peak(signal: Callable[[Solution], TimeSignal | None]) -> Computation:
    """Return the computation of a signal's largest norm; no value without the signal."""
    return lambda solution: found.peak() if (found := signal(solution)) else Metric(None)


def _root_mean_square(signal: Callable[[Solution], TimeSignal | None], order: int = 0) -> Computation:
    """Return the computation of the root mean square of a signal's time derivative; no value without the signal."""
    return lambda solution: found.root_mean_square(order) if (found := signal(solution)) else Metric(None)


def _final(signal: Callable[[Solution], TimeSignal | None], order: int) -> Computation:
    """Return the computation of the norm of a signal's time derivative at its end; no value without the signal."""
    return lambda solution: found.final(order) if (found := signal(solution)) else Metric(None)


def _of_power(joint: int, method: str, *arguments: int) -> Computation:
    """Return the computation of a value of a motor's power; no value without it."""
    value = methodcaller(method, *arguments)
    return lambda solution: value(found) if (found := solution.duty_power(joint)) else Metric(None)


_BOTH_SIDES = "over the motion, both sides of every jump and t = 0+ included"

METRICS: Mapping[str, MetricDefinition] = {
    **{
        f"peak_torque_{joint}": MetricDefinition(
            f"Peak torque, joint {joint}",
            "N.m",
            f"Largest |torque| of motor {joint} {_BOTH_SIDES}.",
            _peak(methodcaller("torque", joint)),
            TORQUES[joint - 1 : joint],
        )
        for joint in (1, 2)
    },
    "peak_modal_deflection_1": MetricDefinition(
        "Modal deflection, link 1",
        "m",
        "Largest |first bending coordinate| of proximal link 1 over the motion.",
        _peak(lambda solution: solution.modal_deflection()),
        (FIRST_BENDING,),
    ),
    **{
        f"peak_tip_deflection_{leg}": MetricDefinition(
            f"Tip deflection, link {leg}",
            "m",
            f"Largest |transverse displacement| of the tip of proximal link {leg} over the motion.",
            _peak(methodcaller("tip_deflection", leg)),
            TIP_DEFLECTIONS[leg - 1 : leg],
        )
        for leg in (1, 2)
    },
    "peak_position_error": MetricDefinition(
        "Peak position error",
        "m",
        "Largest distance from the rigid robot's end effector over motion and dwell.",
        _peak(lambda solution: solution.path_error()),
    ),
    "rms_acceleration_error": MetricDefinition(
        "RMS acceleration error",
        "m/s2",
        "Root mean square over the motion of the distance from the rigid acceleration.",
        _root_mean_square(lambda solution: solution.path_error_in_motion(), order=2),
        ACCELERATION,
    ),
    "end_position_error": MetricDefinition(
        "End position error",
        "m",
        "Distance from the rigid robot's end effector at the end of the motion.",
        _final(lambda solution: solution.path_error_in_motion(), order=0),
    ),
    "end_velocity_error": MetricDefinition(
        "End velocity error",
        "m/s",
        "Norm of the velocity's deviation from the rigid robot's at the end of the motion.",
        _final(lambda solution: solution.path_error_in_motion(), order=1),
        VELOCITY,
    ),
    "end_acceleration_error": MetricDefinition(
        "End acceleration error",
        "m/s2",
        "Norm of the acceleration's deviation at the end of the motion, before the acceleration's last jump.",
        _final(lambda solution: solution.path_error_in_motion(), order=2),
        ACCELERATION,
    ),
    "residual_vibration_amplitude": MetricDefinition(
        "Residual vibration, peak",
        "m",
        "Largest distance from the equilibrium at the end pose during the dwell.",
        _peak(lambda solution: solution.residual_vibration()),
    ),
    "residual_vibration_rms": MetricDefinition(
        "Residual vibration, RMS",
        "m",
        "Root mean square during the dwell of the distance from that equilibrium.",
        _root_mean_square(lambda solution: solution.residual_vibration()),
    ),
    "settling_time": MetricDefinition(
        "Settling time",
        "s",
        "Time after the motion's end from which the end effector stays within the settling band around that equilibrium.",
        lambda solution: solution.settling_time(),
        ("time",),
    ),
}


def _drive_metrics(joint: int) -> Iterator[tuple[str, MetricDefinition]]:
    """Yield name and metric of what a motor has to do."""
    torque, speed = methodcaller("duty_torque", joint), methodcaller("duty_speed", joint)
    for name, label, unit, what, computation in (
        ("rms_torque", "RMS torque", "N.m", "Root mean square of the torque", _root_mean_square(torque)),
        ("peak_speed", "Peak speed", "rad/s", "Largest |angular velocity|", _peak(speed)),
        ("rms_speed", "RMS speed", "rad/s", "Root mean square of the angular velocity", _root_mean_square(speed)),
        ("peak_power", "Peak power", "W", "Largest power into the robot", _of_power(joint, "peak", 1)),
        (
            "peak_regenerated_power",
            "Regenerated power",
            "W",
            "Largest power from the robot into the shaft",
            _of_power(joint, "peak", -1),
        ),
        ("mean_power", "Mean power", "W", "Mean mechanical power", _of_power(joint, "mean")),
        ("positive_energy", "Positive energy", "J", "Energy into the robot, a cycle,", _of_power(joint, "energy", 1)),
        (
            "regenerated_energy",
            "Regenerated energy",
            "J",
            "Energy out of the robot, a cycle,",
            _of_power(joint, "energy", -1),
        ),
        ("net_energy", "Net energy", "J", "Positive minus regenerated energy", _of_power(joint, "energy", 0)),
    ):
        text = f"{what} of motor {joint} over motions and standstills."
        yield (
            f"{name}_{joint}",
            MetricDefinition(f"{label}, joint {joint}", unit, text, computation, TORQUES[joint - 1 : joint]),
        )


DRIVE_METRICS: Mapping[str, MetricDefinition] = {
    name: metric for joint in (1, 2) for name, metric in _drive_metrics(joint)
}
"""What each motor has to do over the duty cycle; tables show them for scenes with motors."""

MOTOR_METRICS: Mapping[str, MetricDefinition] = {
    f"inertia_ratio_{joint}": MetricDefinition(
        f"Inertia ratio, joint {joint}",
        "1",
        f"Largest inertia of the load, reflected to the shaft, over that of the rotor of motor {joint}.",
        methodcaller("inertia_ratio", joint),
    )
    for joint in (1, 2)
}
"""Additional metrics of a scene with motors."""

COMMON_METRICS: Mapping[str, MetricDefinition] = {**METRICS, **DRIVE_METRICS}
"""The metrics of every robot."""

LOOP_METRICS: Mapping[str, MetricDefinition] = {
    **{
        f"peak_tracking_error_{joint}": MetricDefinition(
            f"Tracking error, joint {joint}",
            "rad",
            f"Largest |angle of motor {joint} - planned angle| over motion and dwell.",
            _peak(methodcaller("tracking_error", joint)),
            JOINT_POSITIONS,
        )
        for joint in (1, 2)
    },
    **{
        f"rms_tracking_error_{joint}": MetricDefinition(
            f"RMS tracking error, joint {joint}",
            "rad",
            f"Root mean square over the motion of the angle of motor {joint} - planned angle.",
            _root_mean_square(methodcaller("tracking_error_in_motion", joint)),
            JOINT_POSITIONS,
        )
        for joint in (1, 2)
    },
}
"""Additional metrics of a torque-driven robot."""

ALL_METRICS: Mapping[str, MetricDefinition] = {**COMMON_METRICS, **MOTOR_METRICS, **LOOP_METRICS}
"""The metrics of runs."""

LOOP_FIGURES: Mapping[str, MetricDefinition] = {
    name: MetricDefinition(label, unit, text, display=(shown, convert))
    for name, label, unit, shown, convert, text in (
        (
            "gain_margin",
            "Gain margin",
            "1",
            "dB",
            lambda value: 20.0 * log10(value),
            "Least factor on the torques above 1 with which the loop is unstable.",
        ),
        (
            "gain_reduction",
            "Gain reduction",
            "1",
            "dB",
            lambda value: 20.0 * log10(value) if value > 0.0 else -inf,
            "Largest factor on the torques below 1 with which the loop is unstable; 0 if there is none.",
        ),
        ("phase_margin", "Phase margin", "rad", "deg", degrees, "Phase lag with which the loop is unstable."),
        (
            "delay_margin",
            "Delay margin",
            "s",
            "ms",
            lambda value: 1e3 * value,
            "Delay with which the loop is unstable.",
        ),
        ("disk_margin", "Disk margin", "1", "1", float, "Size of the disk of changes of gain and phase, 0 to 2."),
        (
            "sensitivity_peak",
            "Sensitivity peak",
            "1",
            "1",
            float,
            "Largest gain from disturbances to what remains of them.",
        ),
        (
            "bandwidth",
            "Bandwidth",
            "rad/s",
            "Hz",
            lambda value: 0.5 * value / pi,
            "Lowest frequency at which less than 3 dB of a disturbance are suppressed.",
        ),
        (
            "crossover",
            "Crossover frequency",
            "rad/s",
            "Hz",
            lambda value: 0.5 * value / pi,
            "Highest frequency at which the loop's gain is 1.",
        ),
        (
            "cpu_time",
            "Processor time of the simulation",
            "s",
            "ms",
            lambda value: 1e3 * value,
            "Processor time that the simulation took.",
        ),
    )
}
"""Figures of a loop beside the metrics of its run: the worst margins along the path, and what it costs."""


def metric(name: str, value: float | None, **known: Any) -> Metric:
    """Return a metric by name, with unit, label and description.

    Args:
        name: of `ALL_METRICS` or `LOOP_FIGURES`.
        value: in the SI unit, or a metric without name and unit.
        known: further arguments of `Metric`, ``error`` for example.
    """
    info = definition(name)
    what = {"unit": info.unit, "name": name, "label": info.label, "description": info.description, **known}
    return value.changed(**what) if isinstance(value, Metric) else Metric(value, **what)


def definition(name: str) -> MetricDefinition:
    """Return what a metric of `ALL_METRICS` or a figure of `LOOP_FIGURES` is.

    Raises:
        KeyError: there is none of this name.
    """
    return ALL_METRICS[name] if name in ALL_METRICS else LOOP_FIGURES[name]


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
    info = definition(name)
    text, _ = _printed(info, value, error, digits)
    return text if text == "–" else f"{text} {info.display_unit}".rstrip()


def display_error(name: str, value: float | None, error: float | None) -> str:
    """Format the bound of a metric's numerical error, in its display unit like `display`: ``1e-6``; empty where unknown."""
    _, bound = _printed(definition(name), value, error)
    return bound


def _printed(
    info: MetricDefinition, value: float | None, error: float | None, digits: int | None = None
) -> tuple[str, str]:
    # an error is a small change of the value
    shown = None if value is None else info.displayed(value)
    return printed(shown, None if error is None else info.displayed(error), digits)
