"""Inputs, outputs and parameters of a block, made from its channels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import isfinite

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.imperfections.channels import Channel
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.symbolic import Variable

PerChannel = float | Sequence[float]
"""One number for all channels, or one for each."""


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


def units(channels: Sequence[Channel]) -> list[str]:
    """Return the unit of each channel."""
    return [each.unit for each in channels]


def per_second(unit: str) -> str:
    """Return the unit of a signal's time derivative: ``rad`` → ``rad/s`` → ``rad/s2``."""
    found = re.fullmatch(r"(?P<head>.+)/s(?P<power>\d*)", unit)
    return f"{found['head']}/s{int(found['power'] or 1) + 1}" if found else f"{unit}/s"


def parameters(
    channels: Sequence[Channel],
    key: str,
    values: PerChannel,
    units: Sequence[str],
    what: str,
    *,
    minimum: float | None = None,
) -> list[Variable]:
    """Return the tunable parameters ``<channel>.<key>``.

    Args:
        channels: the channels.
        key: last part of the parameters' names.
        values: their start values.
        units: unit for each channel.
        what: the quantity in words, for descriptions and messages.
        minimum: smallest admissible value; None for none.

    Raises:
        InputError: a value isn't finite or is below the minimum, their number doesn't fit, or a single number stands
            for different units.
    """
    # one finite number for each channel, not below the minimum
    what_in = f"{what} [{', '.join(dict.fromkeys(units))}]"
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what_in} must be a number or one for each channel, got {values!r}") from None
    names = ", ".join(each.name for each in channels)
    if array.shape not in ((), (len(channels),)):
        raise InputError(f"{what_in} must be one number or one for each of {names}, got shape {array.shape}")
    if array.shape == () and len(set(units)) > 1:
        raise InputError(f"{what_in} can't be one number, {array}, for different units: give one for each of {names}")
    numbers = [float(value) for value in np.broadcast_to(array, (len(channels),))]
    for channel, value, unit in zip(channels, numbers, units, strict=True):
        suffix = "" if unit == "1" else f" {unit}"
        if not isfinite(value):
            raise InputError(f"{what} of {channel.name} must be finite, got {value}{suffix}")
        if minimum is not None and value < minimum:
            raise InputError(f"{what} of {channel.name} must be at least {minimum:g}{suffix}, got {value}{suffix}")
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
