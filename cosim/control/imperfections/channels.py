"""The signals that pass through a block: their variables, the block of a law on them, and the memory of their past values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Equations, Vector, block
from flexfmu.cosim.control.controllers.joints import JOINTS, SIGNALS, PerJoint
from flexfmu.cosim.control.sections import LoopContext
from flexfmu.model.scene.imperfections import EncoderSection, SignalSection
from flexfmu.model.symbolic import SymbolicBlock, Variable

REFERENCE_KINDS = ("position", "velocity", "acceleration")
"""Kinds of a reference that a delaying imperfection acts on: all of them."""


class Channels:
    """The n signals that pass through the block of a section, each from its input ``<channel>.input`` to its output ``<channel>``.

    Channels are called like signals, ``joint1.position`` for example.

    Args:
        section: the section.
        context: has the block's name, the values before the first sample, and the sample time where the section has none.
        kinds: kinds that the block acts on, where its signal is the reference.

    Attributes:
        h: time between samples [s].
        outputs: the signals as they go on.
        initial: value of each before the first sample, a parameter ``<channel>.initial`` of the block; None takes that of the first
            sample.
    """

    def __init__(
        self, section: SignalSection | EncoderSection, context: LoopContext, kinds: Sequence[str] = ("position",)
    ) -> None:
        self._name, self._offset, self.h = context.name, section.offset, section.sample_time or context.sample_time
        self.outputs, self.initial = list[Variable](), list[float | None]()
        if isinstance(section, EncoderSection):
            self.add("position")
        elif section.signal == "reference":
            for kind in kinds:
                self.add(kind, context.before(kind), "reference.")
        else:
            self.add(section.signal, context.before(section.signal))

    def add(self, kind: str, initial: Sequence[float] = (), prefix: str = "") -> None:
        """Add the joints' signals ``joint1.<prefix><kind>`` and so on, with their values before the first sample; empty for none."""
        for joint, start in zip(JOINTS, initial or (None, None), strict=True):
            name = f"{joint}.{prefix}{kind}"
            self.outputs.append(Variable(name, SIGNALS[kind][0], f"Signal {name} as it goes on", "output"))
            self.initial.append(start)

    def __len__(self) -> int:
        return len(self.outputs)

    @property
    def inputs(self) -> list[Variable]:
        """The signals as they come."""
        return [
            Variable(f"{each.name}.input", each.unit, f"Signal {each.name} as it comes", "input", start or 0.0)
            for each, start in zip(self.outputs, self.initial, strict=True)
        ]

    def numbers(
        self, key: str, values: PerJoint, what: str, *, minimum: float | None = None, unit: str | None = None
    ) -> list[Variable]:
        """Return the tunable parameters ``<channel>.<key>``.

        Args:
            key: last part of the parameters' names.
            values: their start values, one for all channels or one for each.
            what: the quantity in words, for descriptions.
            minimum: smallest admissible value; None for none.
            unit: of all of them, ``/s`` for that of the channels' rates; None for the channels' own.
        """
        found = []
        for each, value in zip(self.outputs, np.broadcast_to(values, len(self)).tolist(), strict=True):
            own = per_second(each.unit) if unit == "/s" else unit or each.unit
            text = f"{what} of {each.name}"
            found.append(Variable(f"{each.name}.{key}", own, text, "parameter", value, minimum, tunable=True))
        return found

    @property
    def starts(self) -> list[Variable]:
        """The parameters ``<channel>.initial`` of the channels that have an initial value."""
        return [
            Variable(f"{each.name}.initial", each.unit, f"{each.name} before the first sample", "parameter", start)
            for each, start in zip(self.outputs, self.initial, strict=True)
            if start is not None
        ]

    def start(self, initial: Vector, u: Vector) -> Vector:
        """Each channel's value before the first sample (n,), from the values of `starts` and the inputs (n,) of the first sample."""
        given = iter(casadi.vertsplit(initial)) if initial.numel() else iter(())
        return casadi.vertcat(*(u[i] if each is None else next(given) for i, each in enumerate(self.initial)))

    def block(
        self,
        description: str,
        law: Equations,
        parameters: Sequence[Variable] = (),
        *,
        memory: int = 0,
        latency: PerJoint = 0.0,
        inputs: Sequence[Variable] | None = None,
        symbol: Any = casadi.SX,
    ) -> SymbolicBlock:
        """Build the block of a law on the channels; errors as for `flexfmu.cosim.control.blocks.equations.block`.

        Args:
            description, law, parameters, symbol: as for that.
            memory: size of its memory, which starts with a flag, 1 after the first sample.
            latency: delay of the outputs at low frequency [s], one for all or one for each.
            inputs: where they aren't those of all channels.
        """
        late = np.broadcast_to(latency, len(self)).tolist()
        return block(
            self._name,
            description,
            law,
            sample_time=self.h,
            offset=self._offset,
            inputs=self.inputs if inputs is None else inputs,
            outputs=self.outputs,
            parameters=parameters,
            states=[0.0] * (1 + memory) if memory else (),
            latency={each.name: delay for each, delay in zip(self.outputs, late, strict=True) if delay},
            symbol=symbol,
        )


def per_second(unit: str) -> str:
    """Return the unit of a signal's time derivative: ``rad`` → ``rad/s`` → ``rad/s2``."""
    found = re.fullmatch(r"(?P<head>.+)/s(?P<power>\d*)", unit)
    return f"{found['head']}/s{int(found['power'] or 1) + 1}" if found else f"{unit}/s"


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
