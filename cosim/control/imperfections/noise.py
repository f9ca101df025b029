"""Seeded noise: the same random numbers in every run with the same seed, in Python and in an exported FMU."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.imperfections.channels import Channel, empty, recall, remember, sampling, section_channels
from flexfmu.cosim.control.imperfections.random_streams import Streams, draw, seed_parameter, seeded
from flexfmu.cosim.control.imperfections.variables import PerChannel, inputs, outputs, parameters, units
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.model.scene.imperfections import NoiseSection
from flexfmu.model.symbolic import SymbolicBlock, Variable

Draw = Callable[[Streams], tuple[Vector, Streams]]
"""Streams of n channels → random numbers (n,) and the advanced streams."""


def gaussian_noise(
    channels: Sequence[Channel],
    standard_deviation: PerChannel,
    seed: int,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "noise",
) -> SymbolicBlock:
    """Build the block y = u + white Gaussian noise, independent for every channel.

    A normal number is made of two uniform ones, sqrt(-2 ln U) cos(2 pi V) (G. E. P. Box, M. E. Muller, A note on the
    generation of random normal deviates, Annals of Mathematical Statistics 29(2), 1958, pp. 610-611); with
    31 bits its magnitude is at most 6.56. The one-sided power spectral density is 2 h standard_deviation² at sample
    time h.

    A channel's noise depends on its name, the block's name and the seed alone. The standard deviation is a tunable
    parameter ``<channel>.standard_deviation``, the seed a fixed parameter ``seed``.

    Args:
        channels: signals to disturb.
        standard_deviation: in the channels' units, zero or positive.
        seed: whole number from 0 to 2^20 - 1.
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: a standard deviation is negative or not finite, the seed is out of range, or the sample time isn't
            positive.
    """
    what = "the standard deviation"
    scales = parameters(channels, "standard_deviation", standard_deviation, units(channels), what, minimum=0.0)
    return _noise(channels, scales, seed, normal, "Gaussian noise", sample_time, offset, name)


def uniform_noise(
    channels: Sequence[Channel],
    half_width: PerChannel,
    seed: int,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "noise",
) -> SymbolicBlock:
    """Build the block y = u + white noise, uniform in ±half_width, independent for every channel.

    Its variance is half_width² / 3.

    A channel's noise depends on its name, the block's name and the seed alone. The half width is a tunable parameter
    ``<channel>.half_width``, the seed a fixed parameter ``seed``.

    Args:
        channels: signals to disturb.
        half_width: in the channels' units, zero or positive.
        seed: whole number from 0 to 2^20 - 1.
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: a half width is negative or not finite, the seed is out of range, or the sample time isn't positive.
    """
    scales = parameters(channels, "half_width", half_width, units(channels), "the half width", minimum=0.0)
    return _noise(channels, scales, seed, symmetric, "Uniform noise", sample_time, offset, name)


def normal(streams: Streams) -> tuple[Vector, Streams]:
    """Draw normal random numbers (n,) of mean 0 and variance 1; return them and the advanced streams."""
    radius, streams = draw(streams)
    angle, streams = draw(streams)
    return casadi.sqrt(-2.0 * casadi.log(radius)) * casadi.cos(2.0 * pi * angle), streams


def symmetric(streams: Streams) -> tuple[Vector, Streams]:
    """Draw uniform random numbers (n,) in (-1, 1); return them and the advanced streams."""
    value, streams = draw(streams)
    return 2.0 * value - 1.0, streams


def _noise(
    channels: Sequence[Channel],
    scales: Sequence[Variable],
    seed: int,
    numbers: Draw,
    description: str,
    sample_time: float,
    offset: float,
    name: str,
) -> SymbolicBlock:
    """Build the block: inputs plus scaled random numbers."""
    ports, n = inputs(channels), len(channels)
    streams = [f"{name}/{channel.name}" for channel in channels]

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        scale, chosen = split(p, n, 1)
        # next random number of each channel's stream
        values, following = numbers(Streams.of(recall(x, seeded(streams, chosen).states)))
        return u + scale * values, remember(following.states)

    return block(
        name,
        description,
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=ports,
        outputs=outputs(channels),
        parameters=[*scales, seed_parameter(seed, name)],
        states=empty(2 * n),
    )


@builds(NoiseSection)
def _from_section(section: NoiseSection, context: LoopContext) -> SymbolicBlock:
    channels, when = section_channels(section, context), sampling(section, context)
    if section.half_width is not None:
        return uniform_noise(channels, section.half_width, section.seed, name=context.name, **when)
    return gaussian_noise(channels, section.standard_deviation or 0.0, section.seed, name=context.name, **when)
