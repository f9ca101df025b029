"""What all joint controllers share: their signals, gains and limits, and the block of a law; and signals of users by their names.

Gains and limits are tunable parameters of the block, ``joint1.<gain>``, ``joint1.torque.minimum``, ``joint1.torque.maximum``; signals are
named ``joint1.<signal>``, and a feedforward that isn't connected is zero.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from math import isfinite
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.symbolic import Causality, SymbolicBlock, Variable

JOINTS = ("joint1", "joint2")
"""Actuated joints of the five-bar."""

UNITS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s2"}

PerJoint = float | Sequence[float]
"""One number for all joints or signals, or one for each."""

Gains = Mapping[str, tuple[PerJoint, str, str]]
"""Last part of a parameter's name → values, unit, description."""

SIGNALS: dict[str, tuple[str, str]] = {
    **{kind: (unit, f"Measured {kind} of") for kind, unit in UNITS.items()},
    **{f"reference.{kind}": (unit, f"Reference {kind} of") for kind, unit in UNITS.items()},
    "command.velocity": ("rad/s", "Velocity that the outer loop commands of"),
    "command.torque": ("N.m", "Torque that the outer loop commands of"),
    "torque": ("N.m", "Torque that drives"),
    "feedforward": ("N.m", "Torque added to that of the controller of"),
}
"""Name of a joint's signal → unit, description."""

TORQUE = "torque", "Torque of {}, counter-clockwise"
"""Output of a controller."""


def joint_inputs(*names: str) -> list[Variable]:
    """Return the inputs ``joint1.<name>`` and so on, out of `SIGNALS`, those of the first name first."""
    return [
        Variable(f"{joint}.{name}", SIGNALS[name][0], f"{SIGNALS[name][1]} {joint}", "input", 0.0)
        for name in names
        for joint in JOINTS
    ]


def joint_outputs(name: str, text: str) -> list[Variable]:
    """Return the outputs ``joint1.<name>`` and so on; {} in the text stands for the joint."""
    return [Variable(f"{joint}.{name}", SIGNALS[name][0], text.format(joint), "output") for joint in JOINTS]


def saturate(value: Vector, lower: Vector, upper: Vector) -> Vector:
    """Return the value within its limits. NaN stays NaN; minimum and maximum would turn it into a limit."""
    return casadi.if_else(value > upper, upper, casadi.if_else(value < lower, lower, value))


def limited(value: Vector, bounds: Sequence[Vector]) -> Vector:
    """Return the value within its lower and upper bounds; as it is where there are none."""
    return saturate(value, *bounds) if bounds else value


Law = Callable[[Vector, list[Vector], list[Vector]], tuple[Vector, Vector]]
"""(states, signals, gains and limits) → (outputs, next states); every signal, gain and limit is a vector with one element for each
joint."""


def joint_block(
    kind: str,
    description: str,
    law: Law,
    takes: Sequence[str],
    gives: tuple[str, str],
    gains: Gains,
    *,
    sample_time: float,
    offset: float = 0.0,
    limit: Sequence[float] | None = None,
    further: Sequence[Variable] = (),
    states: Sequence[float] = (),
    latency: Sequence[float] = (),
    symbol: Any = casadi.SX,
) -> SymbolicBlock:
    """Build the block of a law.

    Args:
        kind, description, sample_time, offset, symbol: as for `block`.
        law: the law, in which limits follow the gains.
        takes: names of its signals, out of `SIGNALS`.
        gives: name of its output, and description with {} for the joint.
        gains: its tunable parameters, zero or positive.
        limit: largest magnitude of each joint's torque [N.m]; None for none.
        further: parameters after those of the limits.
        states: start values.
        latency: delay of each output at low frequency [s].
    """
    n, outputs = len(JOINTS), joint_outputs(*gives)
    parameters = [
        Variable(f"{joint}.{name}", unit, f"{what} of {joint}", "parameter", value, minimum=0.0, tunable=True)
        for name, (values, unit, what) in gains.items()
        for joint, value in zip(JOINTS, np.broadcast_to(values, n).tolist(), strict=True)
    ]
    limits = [
        Variable(f"{joint}.torque.{end}", "N.m", f"The {end} torque of {joint}", "parameter", sign * each, tunable=True)
        for end, sign in (("minimum", -1.0), ("maximum", 1.0))
        for joint, each in zip(JOINTS, limit or (), strict=False)
    ]
    return block(
        kind,
        description,
        lambda x, u, p: law(x, split(u, n), split(p, n)),
        sample_time=sample_time,
        offset=offset,
        inputs=joint_inputs(*takes),
        outputs=outputs,
        parameters=[*parameters, *limits, *further],
        states=states,
        symbol=symbol,
        latency={each.name: delay for each, delay in zip(outputs, latency, strict=False)},
    )


SIGNAL_UNITS = {
    **{rf"joint\d+\.(reference\.)?{kind}": unit for kind, unit in UNITS.items()},
    **{rf"end_effector\.(reference\.)?{kind}\.[xy]": unit.replace("rad", "m") for kind, unit in UNITS.items()},
    r"joint\d+\.(torque|feedforward|disturbance)": "N.m",
    r"force\.[xy]": "N",
    r"payload\.(mass|change)": "kg",
}
"""Signals of the robot → unit."""


def unit_of(name: str) -> str:
    """Return the unit of a signal of the robot by its name; ``1``, which connects to any unit, for other names."""
    return next((unit for pattern, unit in SIGNAL_UNITS.items() if re.fullmatch(pattern, name)), "1")


def named_signals(names: Sequence[str], causality: Causality, units: Mapping[str, str]) -> list[Variable]:
    """Return the inputs or outputs of these names.

    Args:
        names: names of the signals.
        causality: input or output.
        units: name → unit, where it isn't that of `unit_of`.

    Raises:
        InputError: the names aren't a list of texts.
    """
    if isinstance(names, str) or not all(isinstance(name, str) and name for name in names):
        raise InputError(f'{causality}s must be a list of names, such as ["joint1.position"], got {names!r}')
    start = 0.0 if causality == "input" else None
    return [
        Variable(name, units.get(name) or unit_of(name), f"{causality.capitalize()} {name}", causality, start)
        for name in names
    ]


def named_parameters(values: Mapping[str, float], units: Mapping[str, str]) -> list[Variable]:
    """Return the tunable parameters of these names and values.

    Raises:
        InputError: a value isn't a finite number.
    """
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
            raise InputError(f"the parameter {name!r} must be a finite number, got {value!r}")
    return [
        Variable(name, units.get(name, "1"), f"Parameter {name}", "parameter", float(value), tunable=True)
        for name, value in values.items()
    ]


def check_units(units: Mapping[str, str], names: Sequence[str], where: str) -> None:
    """Check that units belong to variables of these names.

    Raises:
        InputError: a name is none of a variable; the message has the nearest one.
    """
    for name in units:
        if name not in names:
            near = "".join(f"; did you mean {each!r}?" for each in get_close_matches(name, names, n=1, cutoff=0.0))
            raise InputError(f"{where}: `units` names {name!r}, which is no variable{near}")
