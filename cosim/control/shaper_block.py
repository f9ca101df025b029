"""An input shaper for sampled signals: a delay line whose impulses are split over two samples, never rounded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import check_sampling
from flexfmu.model.symbolic import SymbolicBlock, Variable
from flexfmu.trajectories.shapers.sequence import ImpulseSequence

LONGEST_LINE = 20_000
"""Samples of a delay line beyond which the sample time is taken for a mistake in its unit."""

SHAPED = "shaped."
"""What an output's name has before the name of its input."""


@dataclass(frozen=True)
class ShapedSignal:
    """A signal to shape.

    Attributes:
        name, unit: of the input; the output is called ``shaped.<name>``.
        before: what the signal was before the first sample: ``held`` at the first sample's value, as the position of a
            machine at rest, or ``zero``, as its velocity and acceleration.
    """

    name: str
    unit: str
    before: Literal["held", "zero"]


JOINT_REFERENCES = tuple(
    ShapedSignal(f"joint{joint}.reference.{kind}", unit, "held" if kind == "position" else "zero")
    for kind, unit in (("position", "rad"), ("velocity", "rad/s"), ("acceleration", "rad/s2"))
    for joint in (1, 2)
)
"""Position, velocity and acceleration of both joints, as a trajectory outputs them."""


def shaper_block(
    sequence: ImpulseSequence,
    sample_time: float,
    signals: Sequence[ShapedSignal] = JOINT_REFERENCES,
    *,
    offset: float = 0.0,
    name: str = "shaper",
) -> SymbolicBlock:
    """The shaper y_k = Σ w_i u_{k-i}, the weights w being the impulses split over the samples.

    Inputs are named like the signals, outputs ``shaped.<name>``. The line holds each signal's difference from what it
    was before the first sample, so that it can start from zero whatever the start pose is.

    Args:
        sequence: impulses.
        sample_time, offset: [s].
        signals: what to shape, each by itself.
        name: name of the block.

    Raises:
        InputError: there is no signal, or the sample time is out of range.
    """
    check_sampling(sample_time, offset, name)
    if not signals:
        raise InputError(f"{name}: a shaper needs at least one signal to shape")
    weights = _weights(sequence, sample_time, name)
    length, held = len(weights) - 1, [signal.before == "held" for signal in signals]

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # differences to each signal's origin, its first value where it is held before the start
        lines, kept, started = casadi.vertsplit(x, [0, length * len(signals), x.numel() - 1, x.numel()])
        first = [value for value, keep in zip(casadi.vertsplit(u), held, strict=True) if keep]
        origins = casadi.if_else(started, kept, casadi.vertcat(casadi.SX(0, 1), *first))
        rows = iter(casadi.vertsplit(origins)) if any(held) else iter(())
        origin = casadi.vertcat(*(next(rows) if each else casadi.SX(0) for each in held))
        difference = u - origin
        # the present and past differences, weighted by the impulses
        window = casadi.vertcat(difference.T, casadi.reshape(lines, length, len(signals)))
        shaped = origin + casadi.mtimes(window.T, casadi.DM(weights))
        return shaped, casadi.vertcat(casadi.vec(window[:-1, :]), origins, 1)

    return block(
        name,
        f"Input shaper with {len(sequence.times)} impulses within {sequence.duration:g} s",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=[Variable(s.name, s.unit, f"{s.name} before shaping", "input", 0.0) for s in signals],
        outputs=[Variable(SHAPED + s.name, s.unit, f"{s.name} after shaping", "output") for s in signals],
        states=np.zeros(length * len(signals) + sum(held) + 1).tolist(),
    )


def _weights(sequence: ImpulseSequence, sample_time: float, name: str) -> list[float]:
    """Weight of each sample of the line, the current one first."""
    if sequence.duration > LONGEST_LINE * sample_time:
        raise InputError(
            f"{name}: a sample time of {sample_time:g} s makes a line of {sequence.duration / sample_time:.3g} samples for "
            f"impulses within {sequence.duration:g} s; at most {LONGEST_LINE} are allowed: choose a larger sample time"
        )
    # impulses between two samples are split between them
    split = sequence.split(sample_time)
    samples = [round(time / sample_time) for time in split.times]
    weights = np.zeros(samples[-1] + 1)
    weights[samples] = split.amplitudes
    return [float(weight) for weight in weights]
