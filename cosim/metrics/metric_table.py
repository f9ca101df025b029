"""Table of the metrics of a run: name, unit, description and computation of each.

A metric is a function of a `Solution`, the signals of a motion from a recording (`flexfmu.cosim.metrics.metrics`) or
from an estimate (`flexfmu.cosim.design.effects.estimator`): a peak, a root mean square, a final value or a settling
time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import ceil, floor, isfinite, isnan, log10
from operator import methodcaller

from flexfmu.cosim.metrics.signals import (
    ACCELERATION,
    FIRST_BENDING,
    JOINT_POSITIONS,
    POSITION,
    TIP_DEFLECTIONS,
    TORQUES,
    VELOCITY,
)
from flexfmu.cosim.metrics.solution import Measurement as Measurement
from flexfmu.cosim.metrics.solution import Solution as Solution
from flexfmu.cosim.metrics.solution import TimeSignal

Computation = Callable[[Solution], Measurement]
"""Signals of a motion → value of a metric."""


@dataclass(frozen=True)
class Metric:
    """Label, unit, description and computation of a metric.

    Attributes:
        label: short name for tables.
        unit: SI unit of the value in ``summary.json``.
        description: one sentence.
        computation: its value from the signals of a motion.
        columns: recorded signals that it is computed from, whose magnitude bounds its rounding error.
    """

    label: str
    unit: str
    description: str
    computation: Computation
    columns: tuple[str, ...] = POSITION

    @property
    def display_unit(self) -> str:
        """Unit in tables and reports."""
        return _DISPLAY[self.unit][0]

    @property
    def display_factor(self) -> float:
        """Factor from the SI unit to the display unit."""
        return _DISPLAY[self.unit][1]

    @property
    def negligible(self) -> float:
        """Error in the SI unit that never causes a warning, far below what can be measured."""
        return _DISPLAY[self.unit][2]


_DISPLAY: Mapping[str, tuple[str, float, float]] = {
    "m": ("mm", 1e3, 1e-12),
    "m/s": ("m/s", 1.0, 1e-9),
    "m/s2": ("m/s²", 1.0, 1e-5),
    "N.m": ("N·m", 1.0, 1e-9),
    "s": ("s", 1.0, 1e-9),
    "rad": ("mrad", 1e3, 1e-12),
    "rad/s": ("rad/s", 1.0, 1e-9),
    "W": ("W", 1.0, 1e-5),
    "J": ("J", 1.0, 1e-6),
    "1": ("", 1.0, 1e-12),
}
"""SI unit → display unit, factor to it, and negligible error in the SI unit."""


def _peak(signal: Callable[[Solution], TimeSignal | None]) -> Computation:
    """Return the computation of a signal's largest norm; no value without the signal."""
    return lambda solution: found.peak() if (found := signal(solution)) else Measurement(None)


def _root_mean_square(signal: Callable[[Solution], TimeSignal | None], order: int = 0) -> Computation:
    """Return the computation of the root mean square of a signal's time derivative; no value without the signal."""
    return lambda solution: found.root_mean_square(order) if (found := signal(solution)) else Measurement(None)


def _final(signal: Callable[[Solution], TimeSignal | None], order: int) -> Computation:
    """Return the computation of the norm of a signal's time derivative at its end; no value without the signal."""
    return lambda solution: found.final(order) if (found := signal(solution)) else Measurement(None)


def _of_power(joint: int, method: str, *arguments: int) -> Computation:
    """Return the computation of a value of a motor's power; no value without it."""
    value = methodcaller(method, *arguments)
    return lambda solution: value(found) if (found := solution.duty_power(joint)) else Measurement(None)


_BOTH_SIDES = "over the motion, both sides of every jump and t = 0+ included"

METRICS: Mapping[str, Metric] = {
    **{
        f"peak_torque_{joint}": Metric(
            f"Peak torque, joint {joint}",
            "N.m",
            f"Largest |torque| of motor {joint} {_BOTH_SIDES}.",
            _peak(methodcaller("torque", joint)),
            TORQUES[joint - 1 : joint],
        )
        for joint in (1, 2)
    },
    "peak_modal_deflection_1": Metric(
        "Peak modal deflection, link 1",
        "m",
        "Largest |first bending coordinate| of proximal link 1 over the motion.",
        _peak(lambda solution: solution.modal_deflection()),
        (FIRST_BENDING,),
    ),
    **{
        f"peak_tip_deflection_{leg}": Metric(
            f"Peak tip deflection, link {leg}",
            "m",
            f"Largest |transverse displacement| of the tip of proximal link {leg} over the motion.",
            _peak(methodcaller("tip_deflection", leg)),
            TIP_DEFLECTIONS[leg - 1 : leg],
        )
        for leg in (1, 2)
    },
    "peak_position_error": Metric(
        "Peak position error",
        "m",
        "Largest distance from the rigid robot's end effector over motion and dwell.",
        _peak(lambda solution: solution.path_error()),
    ),
    "rms_acceleration_error": Metric(
        "RMS acceleration error",
        "m/s2",
        "Root mean square over the motion of the distance from the rigid acceleration.",
        _root_mean_square(lambda solution: solution.path_error_in_motion(), order=2),
        ACCELERATION,
    ),
    "end_position_error": Metric(
        "End position error",
        "m",
        "Distance from the rigid robot's end effector at the end of the motion.",
        _final(lambda solution: solution.path_error_in_motion(), order=0),
    ),
    "end_velocity_error": Metric(
        "End velocity error",
        "m/s",
        "Norm of the velocity's deviation from the rigid robot's at the end of the motion.",
        _final(lambda solution: solution.path_error_in_motion(), order=1),
        VELOCITY,
    ),
    "end_acceleration_error": Metric(
        "End acceleration error",
        "m/s2",
        "Norm of the acceleration's deviation at the end of the motion, before the acceleration's last jump.",
        _final(lambda solution: solution.path_error_in_motion(), order=2),
        ACCELERATION,
    ),
    "residual_vibration_amplitude": Metric(
        "Residual vibration, amplitude",
        "m",
        "Largest distance from the equilibrium at the end pose during the dwell.",
        _peak(lambda solution: solution.residual_vibration()),
    ),
    "residual_vibration_rms": Metric(
        "Residual vibration, RMS",
        "m",
        "Root mean square during the dwell of the distance from that equilibrium.",
        _root_mean_square(lambda solution: solution.residual_vibration()),
    ),
    "settling_time": Metric(
        "Settling time",
        "s",
        "Time after the motion's end from which the end effector stays within the settling band around that equilibrium.",
        lambda solution: solution.settling_time(),
        ("time",),
    ),
}


def _drive_metrics(joint: int) -> Iterator[tuple[str, Metric]]:
    """Yield name and metric of what a motor has to do."""
    torque, speed = methodcaller("duty_torque", joint), methodcaller("duty_speed", joint)
    for name, label, unit, what, computation in (
        ("rms_torque", "RMS torque", "N.m", "Root mean square of the torque", _root_mean_square(torque)),
        ("peak_speed", "Peak speed", "rad/s", "Largest |angular velocity|", _peak(speed)),
        ("rms_speed", "RMS speed", "rad/s", "Root mean square of the angular velocity", _root_mean_square(speed)),
        ("peak_power", "Peak power", "W", "Largest power into the robot", _of_power(joint, "peak", 1)),
        (
            "peak_regenerated_power",
            "Peak regenerated power",
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
        yield f"{name}_{joint}", Metric(f"{label}, joint {joint}", unit, text, computation, TORQUES[joint - 1 : joint])


DRIVE_METRICS: Mapping[str, Metric] = {name: metric for joint in (1, 2) for name, metric in _drive_metrics(joint)}
"""What each motor has to do over the duty cycle; tables show them for scenes with motors."""

MOTOR_METRICS: Mapping[str, Metric] = {
    f"inertia_ratio_{joint}": Metric(
        f"Inertia ratio, joint {joint}",
        "1",
        f"Largest inertia of the load, reflected to the shaft, over that of the rotor of motor {joint}.",
        methodcaller("inertia_ratio", joint),
    )
    for joint in (1, 2)
}
"""Additional metrics of a scene with motors."""

COMMON_METRICS: Mapping[str, Metric] = {**METRICS, **DRIVE_METRICS}
"""The metrics of every robot."""

LOOP_METRICS: Mapping[str, Metric] = {
    **{
        f"peak_tracking_error_{joint}": Metric(
            f"Peak tracking error, joint {joint}",
            "rad",
            f"Largest |angle of motor {joint} - planned angle| over motion and dwell.",
            _peak(methodcaller("tracking_error", joint)),
            JOINT_POSITIONS,
        )
        for joint in (1, 2)
    },
    **{
        f"rms_tracking_error_{joint}": Metric(
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

ALL_METRICS: Mapping[str, Metric] = {**COMMON_METRICS, **MOTOR_METRICS, **LOOP_METRICS}


DIGITS, DIGITS_WITHOUT_ERROR = 10, 6
"""Largest numbers of significant digits of a value with an error, and of one whose error isn't known."""

SMALLEST, NOISE = -15, -12
"""Powers of ten below which nothing is printed, and up to which the error of a zero isn't worth a word: both are rounding."""


def printed(value: float | None, error: float | None = None, digits: int | None = None) -> tuple[str, str]:
    """Return a value with the digits that its error allows and no others, and a bound of the printed number's error.

    The bound is the power of ten of the last digit; it covers the error and the rounding to that digit. An error of 0.3 and a
    value of 73.6046 are ``74`` and ``1``, an error of 4e-7 makes ``73.604601`` and ``1e-6``.

    Args:
        value: None or NaN where there is none, a dash.
        error: in the unit of the value; None where it isn't known, which leaves the bound empty.
        digits: largest number of significant digits; None for `DIGITS`, or `DIGITS_WITHOUT_ERROR`.
    """
    if value is None or isnan(value):
        return "–", ""
    if error is None or not isfinite(error):
        return f"{value:.{digits or DIGITS_WITHOUT_ERROR}g}", ""
    # the last digit: that of twice the error, or the last one that there may be
    size = floor(log10(abs(value))) if value else SMALLEST
    last = max(size + 1 - (digits or DIGITS), SMALLEST, ceil(log10(2.0 * error) - 1e-12) if error > 0.0 else SMALLEST)
    bound = f"1e{last}" if not -4 < last < 4 else f"{10.0**last:g}"
    rounded = round(value, -last)
    if rounded == 0.0:
        return "0", bound if last > NOISE else ""
    size = floor(log10(abs(rounded)) + 1e-12)
    return (f"{rounded:.{max(-last, 0)}f}" if -5 < size < DIGITS else f"{rounded:.{size - last}e}"), bound


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
    info = ALL_METRICS[name]
    text, _ = _printed(info, value, error, digits)
    return text if text == "–" else f"{text} {info.display_unit}".rstrip()


def display_error(name: str, value: float | None, error: float | None) -> str:
    """Format the bound of a metric's numerical error, in its display unit like `display`: ``below 1e-6``; empty where unknown."""
    _, bound = _printed(ALL_METRICS[name], value, error)
    return f"below {bound}" if bound else ""


def _printed(info: Metric, value: float | None, error: float | None, digits: int | None = None) -> tuple[str, str]:
    factor = info.display_factor
    return printed(None if value is None else value * factor, None if error is None else error * factor, digits)
