"""The metrics of a run: names, units and what each of them says. How they are computed is in `flexfmu.cosim.metrics.metrics`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, floor, log10


@dataclass(frozen=True)
class MetricInfo:
    """What a metric is.

    Attributes:
        label: short name for tables.
        unit: SI unit of the value in ``summary.json``.
        display_unit, display_factor: unit for people, and what to multiply the SI value by.
        negligible: error in the SI unit, far below what can be measured, that never causes a warning.
        description: one sentence.
    """

    label: str
    unit: str
    display_unit: str
    display_factor: float
    negligible: float
    description: str


_NEGLIGIBLE: Mapping[str, float] = {"m": 1e-12, "m/s": 1e-9, "m/s2": 1e-5, "N.m": 1e-9, "s": 1e-9, "rad": 1e-12}

_DISPLAY_UNITS: Mapping[str, str] = {"N.m": "N·m", "m/s2": "m/s²"}


def _millimetres(label: str, description: str) -> MetricInfo:
    return MetricInfo(label, "m", "mm", 1e3, _NEGLIGIBLE["m"], description)


def _plain(label: str, unit: str, description: str) -> MetricInfo:
    return MetricInfo(label, unit, _DISPLAY_UNITS.get(unit, unit), 1.0, _NEGLIGIBLE[unit], description)


_BOTH_SIDES = "over the motion, both sides of every jump and t = 0+ included"

METRICS: Mapping[str, MetricInfo] = {
    "peak_torque_1": _plain("Peak torque, joint 1", "N.m", f"Largest |torque| of motor 1 {_BOTH_SIDES}."),
    "peak_torque_2": _plain("Peak torque, joint 2", "N.m", f"Largest |torque| of motor 2 {_BOTH_SIDES}."),
    "peak_modal_deflection_1": _millimetres(
        "Peak modal deflection, link 1", "Largest |first bending coordinate| of proximal link 1 over the motion."
    ),
    "peak_tip_deflection_1": _millimetres(
        "Peak tip deflection, link 1",
        "Largest |transverse displacement| of the tip of proximal link 1 over the motion.",
    ),
    "peak_tip_deflection_2": _millimetres(
        "Peak tip deflection, link 2",
        "Largest |transverse displacement| of the tip of proximal link 2 over the motion.",
    ),
    "peak_position_error": _millimetres(
        "Peak position error", "Largest distance from the rigid robot's end effector over motion and dwell."
    ),
    "rms_acceleration_error": _plain(
        "RMS acceleration error",
        "m/s2",
        "Root mean square over the motion of the distance from the rigid acceleration.",
    ),
    "end_position_error": _millimetres(
        "End position error", "Distance from the rigid robot's end effector at the end of the motion."
    ),
    "end_velocity_error": _plain(
        "End velocity error", "m/s", "Norm of the velocity's deviation from the rigid robot's at the end of the motion."
    ),
    "end_acceleration_error": _plain(
        "End acceleration error",
        "m/s2",
        "Norm of the acceleration's deviation at the end of the motion, before the acceleration's last jump.",
    ),
    "residual_vibration_amplitude": _millimetres(
        "Residual vibration, amplitude", "Largest distance from the equilibrium at the end pose during the dwell."
    ),
    "residual_vibration_rms": _millimetres(
        "Residual vibration, RMS", "Root mean square during the dwell of the distance from that equilibrium."
    ),
    "settling_time": _plain(
        "Settling time",
        "s",
        "Time after the motion's end from which the end effector stays within the settling band around that equilibrium.",
    ),
}


LOOP_METRICS: Mapping[str, MetricInfo] = {
    f"{kind}_tracking_error_{joint}": MetricInfo(
        f"{label}, joint {joint}", "rad", "mrad", 1e3, _NEGLIGIBLE["rad"], text.format(joint)
    )
    for kind, label, text in (
        ("peak", "Peak tracking error", "Largest |angle of motor {} - planned angle| over motion and dwell."),
        ("rms", "RMS tracking error", "Root mean square over the motion of the angle of motor {} - planned angle."),
    )
    for joint in (1, 2)
}
"""Metrics of a robot that is driven by torques, beside `METRICS`."""

ALL_METRICS: Mapping[str, MetricInfo] = {**METRICS, **LOOP_METRICS}


def display(name: str, value: float | None, digits: int = 6, error: float | None = None) -> str:
    """A metric's value for people, with its unit; a dash where there is none.

    With an error as ``value ± error``: of the value no digit that the error leaves unknown; of the error one digit, rounded up.

    Args:
        name: of the metric, as in ``summary.json``.
        value: in the metric's SI unit; None where the run doesn't have it.
        digits: significant digits of the value, at most.
        error: in the same unit, None or zero where it isn't shown.

    Raises:
        KeyError: there is no such metric.
    """
    info = ALL_METRICS[name]
    if value is None:
        return "–"
    shown = value * info.display_factor
    if not error:
        return f"{shown:.{digits}g} {info.display_unit}"
    # the error, rounded up, and the place of the value's last digit
    scaled = error * info.display_factor
    power = floor(log10(scaled))
    scaled = ceil(scaled / 10.0**power * (1.0 - 1e-12)) * 10.0**power
    last = floor(log10(scaled) + 1e-12)
    size = floor(log10(abs(shown))) if shown else last
    last = max(last, size + 1 - digits)

    # the value to that place
    if shown == 0.0 or size < last:
        text = "0"
    elif -5 < size < digits:
        text = f"{round(shown, -last):.{max(-last, 0)}f}"
    else:
        text = f"{shown:.{size - last}e}"
    margin = f"{scaled:.0f}" if 1.0 <= scaled < 1e4 else f"{scaled:.1g}"
    return f"{text} ± {margin} {info.display_unit}"
