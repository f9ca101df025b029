"""The signals that pass through an imperfection: names, units, values before the first sample, and wiring by name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

import casadi
import numpy as np

from flexfmu.cosim.controllers.equations import Vector
from flexfmu.cosim.controllers.joints import JOINTS, UNITS
from flexfmu.cosim.errors import InputError
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.units import unit_exponents
from flexfmu.model.symbolic import Variable

JOINT_UNITS: dict[str, str] = {str(kind): unit for kind, unit in UNITS.items()} | {"torque": "N.m"}
"""What a joint has: kind of signal → unit."""

PerChannel = float | Sequence[float]
"""One number for all channels, or one for each."""


@dataclass(frozen=True)
class Channel:
    """A signal that passes through a block: output ``name``, as the signal's receiver knows it, and input ``name.input``.

    Attributes:
        name: the signal's name, for example ``joint1.position``.
        unit: its unit, for example ``rad``; ``1`` for none.
        initial: the signal before the first sample, in ``unit``; a parameter ``name.initial`` of the block. None where
            the first sample's own value will do: blocks that pass it on at once start with it, without a bump.
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
    kind: str, initial: Sequence[float | None] = (), joints: Sequence[str] = JOINTS
) -> tuple[Channel, ...]:
    """The joints' channels ``joint1.<kind>``, ``joint2.<kind>``.

    Args:
        kind: position [rad], velocity [rad/s], acceleration [rad/s2] or torque [N.m].
        initial: value before the first sample for each joint; empty for none.
        joints: names of the joints.

    Raises:
        InputError: the kind is unknown, or the number of values isn't that of the joints.
    """
    if kind not in JOINT_UNITS:
        raise InputError(f"joints have {', '.join(JOINT_UNITS)}; got {kind!r}")
    if initial and len(initial) != len(joints):
        raise InputError(f"initial must be one value for each of {', '.join(joints)}, got {len(initial)} values")
    values = initial or [None] * len(joints)
    unit = JOINT_UNITS[kind]
    return tuple(Channel(f"{joint}.{kind}", unit, value) for joint, value in zip(joints, values, strict=True))


def chain(channels: Sequence[Channel], *slaves: str) -> list[tuple[str, str]]:
    """Connections that lead channels from the first slave through imperfections to the last.

    ``chain(channels, "plant", "encoder", "noise", "pd")`` connects ``plant.joint1.position`` to
    ``encoder.joint1.position.input``, ..., ``noise.joint1.position`` to ``pd.joint1.position``.

    Args:
        channels: the channels; only names count.
        slaves: names of source, imperfections in order, receiver.

    Returns:
        Pairs for `flexfmu.cosim.system.connect`.

    Raises:
        InputError: there are fewer than two slaves.
    """
    if len(slaves) < 2:
        raise InputError(f"a chain leads from one slave to another, got {list(slaves)}")
    return [
        (f"{source}.{channel.name}", f"{target}.{channel.name if target == slaves[-1] else channel.input}")
        for source, target in pairwise(slaves)
        for channel in channels
    ]


def inputs(channels: Sequence[Channel]) -> list[Variable]:
    """Inputs of a block, one for each channel.

    Raises:
        InputError: there is no channel.
    """
    if not channels:
        raise InputError("an imperfection needs at least one channel")
    return [
        Variable(each.input, each.unit, f"Signal {each.name}, perfect", "input", each.initial or 0.0)
        for each in channels
    ]


def outputs(channels: Sequence[Channel]) -> list[Variable]:
    """Outputs of a block, one for each channel."""
    return [Variable(each.name, each.unit, f"Signal {each.name}, imperfect", "output") for each in channels]


def units(channels: Sequence[Channel]) -> list[str]:
    """Unit of each channel."""
    return [each.unit for each in channels]


def per_second(unit: str) -> str:
    """Unit of the time derivative of a signal: ``rad`` → ``rad/s`` → ``rad/s2``."""
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
    maximum: float | None = None,
) -> list[Variable]:
    """Tunable parameters ``<channel>.<key>``.

    Args:
        channels: the channels.
        key: last part of the parameters' names.
        values: their start values.
        units: unit for each channel.
        what: the quantity in words.
        minimum, maximum: admissible range.

    Raises:
        InputError: a value isn't finite or is out of range, their number doesn't fit, or one number is given for
            different units.
    """
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
        _check_range(f"{what} of {channel.name}", value, unit, minimum, maximum)
    return [
        Variable(
            f"{each.name}.{key}", unit, f"{what} of {each.name}", "parameter", value, minimum, maximum, tunable=True
        )
        for each, value, unit in zip(channels, numbers, units, strict=True)
    ]


def initial_parameters(channels: Sequence[Channel]) -> list[Variable]:
    """Parameters ``<channel>.initial`` of those channels that have an initial value."""
    return [
        Variable(f"{each.name}.initial", each.unit, f"{each.name} before the first sample", "parameter", each.initial)
        for each in channels
        if each.initial is not None
    ]


def require_initial(channels: Sequence[Channel], block: str) -> None:
    """Make sure that every channel has an initial value.

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
    """What each channel was before the first sample: its initial value, or else the first sample's.

    Args:
        channels: n channels.
        initial: the `initial_parameters`.
        u: inputs of the first sample (n,).
    """
    given = iter(casadi.vertsplit(initial)) if initial.numel() else iter(())
    return casadi.vertcat(*(u[i] if each.initial is None else next(given) for i, each in enumerate(channels)))


def _check_range(what: str, value: float, unit: str, minimum: float | None, maximum: float | None) -> None:
    if not isfinite(value):
        raise InputError(f"{what} must be finite, got {value} {unit}")
    if minimum is not None and value < minimum:
        raise InputError(f"{what} must be at least {minimum:g} {unit}, got {value} {unit}")
    if maximum is not None and value > maximum:
        raise InputError(f"{what} must be at most {maximum:g} {unit}, got {value} {unit}")
