"""The signals that pass through a block: their variables and connections, and the memory of their past values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import isfinite
from numbers import Real
from typing import Any, Unpack

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.equations import BlockOptions, Equations, Vector, block
from flexfmu.cosim.control.controllers.joints import JOINTS, UNITS, PerJoint, per_signal
from flexfmu.cosim.control.sections import LoopContext
from flexfmu.cosim.engine.errors import InputError
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.units import unit_exponents
from flexfmu.model.scene.imperfections import EncoderSection, SignalSection
from flexfmu.model.scene.loop import Sampling
from flexfmu.model.symbolic import SymbolicBlock, Variable

JOINT_UNITS: dict[str, str] = {str(kind): unit for kind, unit in UNITS.items()} | {"torque": "N.m"}
"""Kind of a joint's signal → unit."""

PerChannel = PerJoint
"""One number for all channels, or one for each."""


@dataclass(frozen=True)
class Channel:
    """A signal that passes through a block, from its input ``name.input`` to its output ``name``.

    Attributes:
        name: the signal's name, for example ``joint1.position``.
        unit: its unit, for example ``rad``; ``1`` for none.
        initial: value before the first sample, in ``unit``; a parameter ``name.initial`` of the block. None takes the
            value of the first sample, in blocks with direct feedthrough.

    Raises:
        InputError: the name is empty, the unit unknown, or the initial value not finite.
    """

    name: str
    unit: str = "1"
    initial: float | None = None

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("a channel needs a name, for example joint1.position")
        try:
            unit_exponents(self.unit)
        except ModelError as error:
            raise InputError(f"channel {self.name}: {error}") from None
        if self.initial is not None and not isfinite(self.initial):
            raise InputError(f"channel {self.name}: the initial value must be finite, got {self.initial} {self.unit}")

    @property
    def input(self) -> str:
        """Name of the block's input."""
        return f"{self.name}.input"


def joint_channels(
    kind: str, initial: Sequence[float | None] | NDArray[np.float64] = (), joints: Sequence[str] = JOINTS
) -> tuple[Channel, ...]:
    """Return the joints' channels ``joint1.<kind>``, ``joint2.<kind>``.

    Args:
        kind: position [rad], velocity [rad/s], acceleration [rad/s2] or torque [N.m].
        initial: value before the first sample for each joint (joints,); empty for none.
        joints: names of the joints.

    Raises:
        InputError: the kind is unknown, or the values aren't one number for each joint.
    """
    if kind not in JOINT_UNITS:
        raise InputError(f"joints have {', '.join(JOINT_UNITS)}; got {kind!r}")
    # one number for each joint, or none at all
    starts = list(initial) if isinstance(initial, Sequence | np.ndarray) and np.ndim(np.asarray(initial)) == 1 else [""]
    numbers = all(each is None or isinstance(each, Real) for each in starts)
    if not numbers or len(starts) not in (0, len(joints)):
        raise InputError(f"initial must be one number for each of {', '.join(joints)}, got {initial!r}")
    # empty: channels without initial values
    values = [None if each is None else float(each) for each in starts] or [None] * len(joints)
    unit = JOINT_UNITS[kind]
    return tuple(Channel(f"{joint}.{kind}", unit, value) for joint, value in zip(joints, values, strict=True))


REFERENCE_KINDS = ("position", "velocity", "acceleration")
"""Kinds of a reference that a delaying imperfection acts on: all of them."""


def section_channels(
    section: SignalSection, context: LoopContext, kinds: Sequence[str] = ("position",)
) -> tuple[Channel, ...]:
    """Return the channels of a section of the scene file, with their values before the first sample.

    Args:
        section: the section.
        context: has the values before the first sample.
        kinds: kinds that the imperfection acts on, where its signal is the reference.
    """
    if section.signal != "reference":
        return joint_channels(section.signal, context.before(section.signal))
    names = [f"{joint}.reference" for joint in JOINTS]
    return tuple(channel for kind in kinds for channel in joint_channels(kind, context.before(kind), names))


def sampling(section: SignalSection | EncoderSection, context: LoopContext) -> Sampling:
    """Return sample time and offset [s] of a section's block."""
    return Sampling(sample_time=section.sample_time or context.sample_time, offset=section.offset)


def inputs(channels: Sequence[Channel]) -> list[Variable]:
    """Return the inputs of a block, one for each channel.

    Raises:
        InputError: there is no channel.
    """
    if not channels:
        raise InputError("an imperfection needs at least one channel")
    return [
        Variable(each.input, each.unit, f"Signal {each.name} as it comes", "input", each.initial or 0.0)
        for each in channels
    ]


def outputs(channels: Sequence[Channel]) -> list[Variable]:
    """Return the outputs of a block, one for each channel."""
    return [Variable(each.name, each.unit, f"Signal {each.name} as it goes on", "output") for each in channels]


def per_second(unit: str) -> str:
    """Return the unit of a signal's time derivative: ``rad`` → ``rad/s`` → ``rad/s2``."""
    found = re.fullmatch(r"(?P<head>.+)/s(?P<power>\d*)", unit)
    return f"{found['head']}/s{int(found['power'] or 1) + 1}" if found else f"{unit}/s"


def parameters(
    channels: Sequence[Channel],
    key: str,
    values: PerChannel,
    what: str,
    *,
    minimum: float | None = None,
    units: Sequence[str] | None = None,
) -> list[Variable]:
    """Return the tunable parameters ``<channel>.<key>``.

    Args:
        channels: the channels.
        key: last part of the parameters' names.
        values: their start values.
        what: the quantity in words, for descriptions and messages.
        minimum: smallest admissible value; None for none.
        units: unit for each channel; None for the channels' own.

    Raises:
        InputError: as for `per_signal`.
    """
    units = [each.unit for each in channels] if units is None else units
    numbers = per_signal([each.name for each in channels], what, values, units, minimum)
    return [
        Variable(f"{each.name}.{key}", unit, f"{what} of {each.name}", "parameter", value, minimum, tunable=True)
        for each, value, unit in zip(channels, numbers, units, strict=True)
    ]


def initial_parameters(channels: Sequence[Channel]) -> list[Variable]:
    """Return the parameters ``<channel>.initial`` of the channels that have an initial value."""
    return [
        Variable(f"{each.name}.initial", each.unit, f"{each.name} before the first sample", "parameter", each.initial)
        for each in channels
        if each.initial is not None
    ]


def require_initial(channels: Sequence[Channel], block: str) -> None:
    """Check that every channel has an initial value.

    Raises:
        InputError: one has none.
    """
    for each in channels:
        if each.initial is None:
            raise InputError(
                f"{block}: its first output is the value of {each.name} [{each.unit}] before the first sample; give it, "
                f"for example Channel({each.name!r}, {each.unit!r}, initial=0.0)"
            )


def start_values(channels: Sequence[Channel], initial: Vector, u: Vector) -> Vector:
    """Return each channel's value before the first sample (n,): the initial value, otherwise the first sample.

    Args:
        channels: n channels.
        initial: values of the `initial_parameters`.
        u: inputs of the first sample (n,).
    """
    given = iter(casadi.vertsplit(initial)) if initial.numel() else iter(())
    return casadi.vertcat(*(u[i] if each.initial is None else next(given) for i, each in enumerate(channels)))


def channel_block(
    kind: str,
    description: str,
    law: Equations,
    channels: Sequence[Channel],
    numbers: Sequence[Variable] = (),
    *,
    memory: int = 0,
    latency: Mapping[str, float] | None = None,
    further: Sequence[Channel] = (),
    symbol: Any = casadi.SX,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """Build the block of a law on channels; errors as for `block`.

    Args:
        kind, description, law, latency, symbol, options: as for `block`.
        channels: the signals that pass through it.
        numbers: its parameters.
        memory: size of its memory, which starts with a flag, 1 after the first sample.
        further: channels that are outputs alone.
    """
    return block(
        kind,
        description,
        law,
        inputs=inputs(channels),
        outputs=outputs([*channels, *further]),
        parameters=numbers,
        states=[0.0] * (1 + memory) if memory else (),
        latency=latency,
        symbol=symbol,
        **options,
    )


def repeated(values: Vector, times: int) -> Vector:
    """Return copies of a vector (n,) one below the other, (times * n,), by a single operation of CasADi."""
    return casadi.vec(casadi.repmat(values, 1, times))


def cut(vector: Vector, *sizes: int) -> list[Vector]:
    """Split a column vector into pieces of these sizes, which may be zero; what remains is dropped.

    Slices won't do: an empty slice of a vector of length one has the shape (1, 0), which `vertcat` doesn't drop.
    """
    edges = list(accumulate(sizes, initial=0))
    pieces: list[Vector] = casadi.vertsplit(vector, [*edges, vector.numel()])
    return pieces[: len(sizes)]


def recall(x: Vector, start: Vector) -> Vector:
    """Return the memory (size,) from the states, or ``start`` (size,) at the first sample."""
    return casadi.if_else(x[0], x[1:], start)


def remember(*values: Vector) -> Vector:
    """Return the next states, which store these vectors until the next sample."""
    return casadi.vertcat(1.0, *values)


def whole_number(what: str, value: int, lowest: int, highest: int | None = None, hint: str = "") -> int:
    """Check a whole number and return it.

    Args:
        what: the quantity in words, for the message.
        value: the number.
        lowest, highest: admissible range; None for no upper limit.
        hint: a remedy, for the message.

    Raises:
        InputError: it is no whole number or is out of range.
    """
    is_whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not is_whole or value < lowest or (highest is not None and value > highest):
        span = f"at least {lowest}" if highest is None else f"from {lowest} to {highest}"
        raise InputError(f"{what} must be a whole number, {span}, got {value!r}{hint and f'; {hint}'}")
    return int(value)
