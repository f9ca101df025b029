"""Quantisation of signals by converters and encoders."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.joints import JOINTS
from flexfmu.cosim.control.imperfections.channels import (
    Channel,
    cut,
    empty,
    joint_channels,
    recall,
    remember,
    repeated,
    sampling,
    section_channels,
)
from flexfmu.cosim.control.imperfections.variables import PerChannel, inputs, outputs, parameters, units, whole_number
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.model.scene.imperfections import EncoderSection, QuantisationSection
from flexfmu.model.symbolic import SymbolicBlock


def quantisation(
    channels: Sequence[Channel],
    resolution: PerChannel,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "quantisation",
) -> SymbolicBlock:
    """Build the block y = q floor(u / q + 1/2), the nearest multiple of the resolution q, without states.

    The error is at most q/2. For a signal that crosses many steps it is approximately white and uniform, of variance
    q²/12 (B. Widrow, I. Kollár, Quantization Noise, 2008, on pseudo-quantization noise). The resolution is a tunable
    parameter ``<channel>.resolution``; zero switches the quantisation off.

    Args:
        channels: signals to quantise.
        resolution: q in the channels' units, zero or positive.
        sample_time: time between samples [s].
        offset: first sample instant [s].
        name: name of the block.

    Raises:
        InputError: a resolution is negative or not finite, or the sample time isn't positive.
    """
    ports = inputs(channels)

    # a resolution of zero passes the signal unchanged
    def equations(x: Vector, u: Vector, q: Vector) -> tuple[Vector, Vector]:
        return casadi.if_else(q > 0.0, q * nearest(u / q), u), x

    return block(
        name,
        "Quantisation",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=ports,
        outputs=outputs(channels),
        parameters=parameters(channels, "resolution", resolution, units(channels), "the resolution", minimum=0.0),
    )


def encoder(
    counts_per_turn: PerChannel,
    *,
    sample_time: float,
    offset: float = 0.0,
    window: int = 1,
    joints: Sequence[str] = JOINTS,
    name: str = "encoder",
) -> SymbolicBlock:
    """Build the block of incremental encoders: angles to the nearest count, rates by difference.

    With q = 2 pi / counts_per_turn, sample time h and window w::

        c_k = floor(q_k / q + 1/2),  position = q c_k,  velocity = q (c_k - c_k-w) / (w h)

    so the rate has a resolution of q / (w h) and a delay of w h / 2. Before the first sample the joints are assumed at
    rest. Inputs: ``joint1.position.input``; outputs ``joint1.position`` and ``joint1.velocity``; parameter
    ``joint1.position.counts_per_turn``.

    Args:
        counts_per_turn: counts per turn of the joint, gear ratio and fourfold evaluation of the lines included; at
            least 1.
        sample_time: time between samples [s].
        offset: first sample instant [s].
        window: w, number of sample times that the difference spans, at least 1.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: the counts are below 1 or not finite, the window isn't a whole number from 1, or the sample time
            isn't positive.
    """
    whole_number(f"{name}: the window in samples", window, 1)
    angles, rates = joint_channels("position", joints=joints), joint_channels("velocity", joints=joints)
    ports, n = inputs(angles), len(angles)

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # angle in whole counts
        resolution = 2.0 * pi / p
        counts = nearest(u / resolution)
        # velocity from the difference over the window
        past = recall(x, repeated(counts, window))
        velocity = (counts - past[-n:]) * (resolution / (window * sample_time))
        return casadi.vertcat(resolution * counts, velocity), remember(counts, *cut(past, n * (window - 1)))

    return block(
        name,
        "Incremental encoders",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=ports,
        outputs=[*outputs(angles), *outputs(rates)],
        parameters=parameters(
            angles, "counts_per_turn", counts_per_turn, ["1"] * n, "the number of counts per turn", minimum=1.0
        ),
        states=empty(window * n),
        latency={each.name: window * sample_time / 2.0 for each in rates},
    )


def nearest(value: Vector) -> Vector:
    """Return the nearest whole number; a half is rounded up."""
    return casadi.floor(value + 0.5)


@builds(QuantisationSection)
def _from_section(section: QuantisationSection, context: LoopContext) -> SymbolicBlock:
    return quantisation(section_channels(section, context), section.resolution, **sampling(section, context))


@builds(EncoderSection)
def _encoder_from_section(section: EncoderSection, context: LoopContext) -> SymbolicBlock:
    return encoder(section.counts_per_turn, window=section.window, **sampling(section, context))
