"""What all joint controllers share: their signals, gains and limits, and the block of a law.

A maker of a joint controller takes its gains, one number for all joints or one for each, and the options of `JointOptions`. Gains and
limits are tunable parameters of the block, ``joint1.<gain>``, ``joint1.torque.minimum``, ``joint1.torque.maximum``; signals are named
``joint1.<signal>``, and a feedforward that isn't connected is zero. ``limits`` are torque limits [N.m]: `Limits`, a number or one for each
joint for both ways, or None for none.

Raises:
    InputError: a gain is negative or not finite, their number doesn't fit, a lower limit isn't below its upper one, or the sample time
        isn't positive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal, Unpack

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import BlockOptions, Vector, block, split
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.symbolic import SymbolicBlock, Variable

JOINTS = ("joint1", "joint2")
"""Actuated joints of the five-bar."""

JointQuantity = Literal["position", "velocity", "acceleration"]
UNITS: dict[JointQuantity, str] = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s2"}

PerJoint = float | Sequence[float]
"""One number for all joints, or one for each."""

Gains = Mapping[str, tuple[PerJoint, str, str]]
"""Last part of a parameter's name → values, unit, description."""


class JointOptions(BlockOptions, total=False):
    """Options of all blocks of joints; ``joints`` are their names."""

    joints: Sequence[str]


SIGNALS: dict[str, tuple[str, str]] = {
    **{str(kind): (unit, f"Measured {kind} of") for kind, unit in UNITS.items()},
    **{f"reference.{kind}": (unit, f"Reference {kind} of") for kind, unit in UNITS.items()},
    "command.velocity": ("rad/s", "Velocity that the outer loop commands of"),
    "command.torque": ("N.m", "Torque that the outer loop commands of"),
    "torque": ("N.m", "Torque that drives"),
    "feedforward": ("N.m", "Torque added to that of the controller of"),
}
"""Name of a joint's signal → unit, description."""

TORQUE = "torque", "Torque of {}, counter-clockwise"
"""Output of a controller."""


def joint_inputs(joints: Sequence[str], *names: str) -> list[Variable]:
    """Return the inputs ``joint1.<name>`` and so on, out of `SIGNALS`, those of the first name first."""
    return [
        Variable(f"{joint}.{name}", SIGNALS[name][0], f"{SIGNALS[name][1]} {joint}", "input", 0.0)
        for name in names
        for joint in joints
    ]


def joint_outputs(joints: Sequence[str], name: str, text: str) -> list[Variable]:
    """Return the outputs ``joint1.<name>`` and so on; {} in the text stands for the joint."""
    return [Variable(f"{joint}.{name}", SIGNALS[name][0], text.format(joint), "output") for joint in joints]


def per_signal(
    names: Sequence[str], what: str, values: PerJoint, units: Sequence[str], minimum: float | None = None
) -> tuple[float, ...]:
    """Return one value for each of several signals or joints.

    Args:
        names: their names.
        what: the quantity in words.
        values: one number for all, or one for each.
        units: unit of each.
        minimum: smallest admissible value; None for none.

    Raises:
        InputError: a value isn't finite or is below the minimum, their number doesn't fit, or a single number stands
            for different units.
    """
    # one number for all, or one for each
    of, what_in = ", ".join(names), f"{what} [{', '.join(dict.fromkeys(units))}]"
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what_in} must be a number or one for each of {of}, got {values!r}") from None
    if array.shape not in ((), (len(names),)):
        raise InputError(f"{what_in} must be one number or one for each of {of}, got shape {array.shape}")
    if array.shape == () and len(set(units)) > 1:
        raise InputError(f"{what_in} can't be one number, {array}, for different units: give one for each of {of}")
    result = tuple(float(value) for value in np.broadcast_to(array, (len(names),)))
    # check each value
    for name, value, unit in zip(names, result, units, strict=True):
        suffix = "" if unit == "1" else f" {unit}"
        if not isfinite(value):
            raise InputError(f"{what} of {name} must be finite, got {value}{suffix}")
        if minimum is not None and value < minimum:
            raise InputError(f"{what} of {name} must be at least {minimum:g}{suffix}, got {value}{suffix}")
    return result


def per_joint(
    joints: Sequence[str], what: str, values: PerJoint, unit: str, minimum: float | None = None
) -> tuple[float, ...]:
    """Return one value for each joint; arguments and errors as for `per_signal`."""
    return per_signal(joints, what, values, [unit] * len(joints), minimum)


@dataclass(frozen=True)
class Limits:
    """Smallest and largest torque [N.m]: one number for all joints, or one for each."""

    lower: PerJoint
    upper: PerJoint


TorqueLimits = Limits | PerJoint | None
"""Limits, or one number for both ways; None for none."""


def symmetric(limit: PerJoint) -> Limits:
    """Return the limits ±limit [N.m]."""
    lower = -limit if isinstance(limit, (int, float)) else tuple(-value for value in limit)
    return Limits(lower, limit)


def bounds_of(limits: TorqueLimits, joints: Sequence[str]) -> tuple[tuple[float, ...], ...]:
    """Return lower and upper limits of each joint; empty for none.

    Raises:
        InputError: a limit isn't finite, or the lower one isn't below the upper one.
    """
    if limits is None:
        return ()
    limits = limits if isinstance(limits, Limits) else symmetric(limits)
    lower = per_joint(joints, "the lower torque limit", limits.lower, "N.m")
    upper = per_joint(joints, "the upper torque limit", limits.upper, "N.m")
    for joint, low, high in zip(joints, lower, upper, strict=True):
        if not low < high:
            raise InputError(f"{joint}: the lower torque limit {low} N.m must be below the upper one, {high} N.m")
    return lower, upper


def limit_parameters(limits: TorqueLimits, joints: Sequence[str]) -> list[Variable]:
    """Return the tunable parameters of limits: all minima, then all maxima; errors as for `bounds_of`."""
    return [
        Variable(f"{joint}.torque.{end}", "N.m", f"The {end} torque of {joint}", "parameter", value, tunable=True)
        for end, values in zip(("minimum", "maximum"), bounds_of(limits, joints), strict=False)
        for joint, value in zip(joints, values, strict=True)
    ]


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
    limits: TorqueLimits = None,
    further: Sequence[Variable] = (),
    states: Sequence[float] = (),
    latency: Sequence[float] = (),
    symbol: Any = casadi.SX,
    joints: Sequence[str] = JOINTS,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """Build the block of a law.

    Args:
        kind, description: of the block; the kind is its name by default.
        law: the law, in which limits follow the gains.
        takes: names of its signals, out of `SIGNALS`.
        gives: name of its output, and description with {} for the joint.
        gains: its tunable parameters, zero or positive.
        limits: torque limits.
        further: parameters after those of the limits.
        states: start values.
        latency: delay of each output at low frequency [s].
        symbol: see `block`.
        joints, options: see `JointOptions`.

    Raises:
        InputError: as above.
    """
    parameters = [
        Variable(f"{joint}.{name}", unit, f"{what} of {joint}", "parameter", value, minimum=0.0, tunable=True)
        for name, (values, unit, what) in gains.items()
        for joint, value in zip(joints, per_joint(joints, name, values, unit, minimum=0.0), strict=True)
    ]
    outputs, n = joint_outputs(joints, *gives), len(joints)
    return block(
        kind,
        description,
        lambda x, u, p: law(x, split(u, n), split(p, n)),
        inputs=joint_inputs(joints, *takes),
        outputs=outputs,
        parameters=[*parameters, *limit_parameters(limits, joints), *further],
        states=states,
        symbol=symbol,
        latency={each.name: delay for each, delay in zip(outputs, latency, strict=False)},
        **options,
    )
