"""Motors and stresses in reports and in the terminal: tables of margins, and torque over speed against the limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.experiment.prepared_scene import Run
from flexfmu.cosim.metrics.motors import MOTOR_VALUES, MotorLoad, motor_loads
from flexfmu.cosim.reports.chart import Curve, Panel
from flexfmu.cosim.reports.page import Plot
from flexfmu.cosim.reports.svg import FIRST, GREY, SECOND


def motor_rows(motors: Sequence[Mapping[str, Any]]) -> dict[str, tuple[str, ...]]:
    """Return name of a quantity → its text for each motor: value, limit and use."""
    rows = {}
    for margins in zip(*(motor["margins"] for motor in motors), strict=True):
        texts = (
            f"{each['value']:.4g} of {each['limit']:g} {shown_unit(each['unit'])}, {100 * each['use']:.0f} %"
            for each in margins
        )
        rows[margins[0]["name"]] = tuple(texts)
    for key, name, unit in MOTOR_VALUES:
        values = [motor[key] for motor in motors]
        if any(value is not None for value in values):
            rows[name] = tuple("–" if value is None else f"{value:.4g} {shown_unit(unit)}".rstrip() for value in values)
    return rows


def stress_rows(links: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return name of a link → its peak stress, where and when it is, and the safety factor."""
    return {each["link"]: _stress_text(each) for each in links}


def _stress_text(link: Mapping[str, Any]) -> str:
    peak = link["combined"]
    if peak is None:
        return "no modes, stress not known"
    change = "" if link["change"] is None else f", last mode {100.0 * link['change']:.2g} %"
    safety = "" if link["safety"] is None else f", safety {link['safety']:.3g}"
    return f"{1e-6 * peak['value']:.4g} MPa at {1e3 * peak['place']:.4g} mm, {peak['time']:.4g} s{change}{safety}"


def motor_plots(run: Run) -> Iterator[Plot]:
    """Yield torque over speed of each motor with its limits, and power over time; nothing for a scene without motors."""
    loads = motor_loads(run)
    if not loads:
        return
    caption = "At the shaft, with the limits of the motor: peak torque and speed, and dashed the continuous torque."
    for load in loads:
        yield Plot(
            f"motor-{load.joint}", f"Torque over speed, {load.label}", caption, (_over_speed(load),), "speed [rad/s]"
        )
    curves = [
        Curve(load.time, load.power, load.label, colour) for load, colour in zip(loads, (FIRST, SECOND), strict=True)
    ]
    panel = Panel(label="power [W]", curves=curves)
    yield Plot("motor-power", "Mechanical power of the motors", "At the shaft; negative: regenerated.", (panel,))


def _over_speed(load: MotorLoad) -> Panel:
    """Return the path of speed and torque within the rectangles of the limits."""
    motor = load.motor
    corners = np.array([[-1.0, 1.0, 1.0, -1.0, -1.0], [-1.0, -1.0, 1.0, 1.0, -1.0]])
    limits = [
        Curve(motor.maximum_speed * corners[0], torque * corners[1], name, GREY, dashes=dashes, is_read=False)
        for torque, name, dashes in (
            (motor.peak_torque, "peak torque, speed", ""),
            (motor.continuous_torque, "continuous torque", "3.6,2.7"),
        )
    ]
    colour = FIRST if load.joint == 1 else SECOND
    path = Curve(load.speed, load.torque, load.label, colour, more={"time [s]": load.time})
    return Panel(label="torque [N·m]", curves=[*limits, path], is_function=False)
