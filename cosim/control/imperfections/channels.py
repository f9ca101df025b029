"""The signals that pass through a block: their variables and connections, and the memory of their past values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Equations, Vector, block
from flexfmu.cosim.control.controllers.joints import JOINTS, UNITS, PerJoint
from flexfmu.cosim.control.sections import LoopContext
from flexfmu.model.scene.imperfections import EncoderSection, SignalSection
from flexfmu.model.symbolic import SymbolicBlock, Variable

JOINT_UNITS: dict[str, str] = {str(kind): unit for kind, unit in UNITS.items()} | {"torque": "N.m"}
"""Kind of a joint's signal → unit."""

REFERENCE_KINDS = ("position", "velocity", "acceleration")
"""Kinds of a reference that a delaying imperfection acts on: all of them."""


@dataclass(frozen=True)
class Channel:
    """A signal that passes through a block, from its input ``name.input`` to its output ``name``.

    Attributes:
        name: the signal's name, for example ``joint1.position``.
        unit: its unit, for example ``rad``.
        initial: value before the first sample, in ``unit``; a parameter ``name.initial`` of the block. None takes the
            value of the first sample.
    """

    name: str
    unit: str
    initial: float | None = None


def joint_channels(kind: str, initial: Sequence[float] = (), prefix: str = "") -> tuple[Channel, ...]:
    """Return the joints' channels ``joint1.<prefix><kind>``, ``joint2.<prefix><kind>``.

    Args:
        kind: position [rad], velocity [rad/s], acceleration [rad/s2] or torque [N.m].
        initial: value before the first sample for each joint (joints,); empty for none.
        prefix: of the kind.
    """
    starts = zip(JOINTS, initial or (None, None), strict=True)
    return tuple(Channel(f"{joint}.{prefix}{kind}", JOINT_UNITS[kind], start) for joint, start in starts)


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
    return tuple(channel for kind in kinds for channel in joint_channels(kind, context.before(kind), "reference."))


def sample_time(section: SignalSection | EncoderSection, context: LoopContext) -> float:
    """Return the time between samples of a section's block [s]."""
    return section.sample_time or context.sample_time


def inputs(channels: Sequence[Channel]) -> list[Variable]:
    """Return the inputs of a block, one for each channel."""
    return [
        Variable(f"{each.name}.input", each.unit, f"Signal {each.name} as it comes", "input", each.initial or 0.0)
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
    values: PerJoint,
    what: str,
    *,
    minimum: float | None = None,
    units: Sequence[str] | None = None,
) -> list[Variable]:
    """Return the tunable parameters ``<channel>.<key>``.

    Args:
        channels: the channels.
        key: last part of the parameters' names.
        values: their start values, one for all channels or one for each.
        what: the quantity in words, for descriptions.
        minimum: smallest admissible value; None for none.
        units: unit for each channel; None for the channels' own.
    """
    units = [each.unit for each in channels] if units is None else units
    return [
        Variable(f"{each.name}.{key}", unit, f"{what} of {each.name}", "parameter", value, minimum, tunable=True)
        for each, value, unit in zip(channels, np.broadcast_to(values, len(channels)).tolist(), units, strict=True)
    ]


def initial_parameters(channels: Sequence[Channel]) -> list[Variable]:
    """Return the parameters ``<channel>.initial`` of the channels that have an initial value."""
    return [
        Variable(f"{each.name}.initial", each.unit, f"{each.name} before the first sample", "parameter", each.initial)
        for each in channels
        if each.initial is not None
    ]


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
    section: SignalSection | EncoderSection,
    context: LoopContext,
    description: str,
    law: Equations,
    channels: Sequence[Channel],
    numbers: Sequence[Variable] = (),
    *,
    memory: int = 0,
    latency: Mapping[str, float] | None = None,
    further: Sequence[Channel] = (),
    symbol: Any = casadi.SX,
) -> SymbolicBlock:
    """Build the block of a law on channels; errors as for `block`.

    Args:
        section: has sample time and offset.
        context: has the block's name, and the sample time where the section has none.
        description, law, latency, symbol: as for `block`.
        channels: the signals that pass through it.
        numbers: its parameters.
        memory: size of its memory, which starts with a flag, 1 after the first sample.
        further: channels that are outputs alone.
    """
    return block(
        context.name,
        description,
        law,
        sample_time=sample_time(section, context),
        offset=section.offset,
        inputs=inputs(channels),
        outputs=outputs([*channels, *further]),
        parameters=numbers,
        states=[0.0] * (1 + memory) if memory else (),
        latency=latency,
        symbol=symbol,
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
