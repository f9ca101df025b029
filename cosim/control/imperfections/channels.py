"""The signals that pass through an imperfection, their connections, and the memory of their past values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from math import isfinite
from numbers import Real

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.controllers.joints import JOINTS, UNITS
from flexfmu.cosim.control.sections import LoopContext
from flexfmu.cosim.engine.errors import InputError
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.units import unit_exponents
from flexfmu.model.scene.imperfections import EncoderSection, SignalSection
from flexfmu.model.scene.loop import Sampling

JOINT_UNITS: dict[str, str] = {str(kind): unit for kind, unit in UNITS.items()} | {"torque": "N.m"}
"""Kind of a joint's signal → unit."""


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


def chain(channels: Sequence[Channel], *slaves: str) -> list[tuple[str, str]]:
    """Return the connections of channels from the first slave through imperfections to the last.

    ``chain(channels, "plant", "encoder", "noise", "pd")`` connects ``plant.joint1.position`` to
    ``encoder.joint1.position.input``, ..., ``noise.joint1.position`` to ``pd.joint1.position``.

    Args:
        channels: the channels; only their names matter.
        slaves: names of the source, the imperfections in order, and the receiver.

    Returns:
        Pairs for `flexfmu.cosim.engine.master.system.connect`.

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


def empty(size: int) -> list[float]:
    """Return start states of a memory: a flag, 1 after the first sample, then ``size`` numbers."""
    return [0.0] * (1 + size)


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
