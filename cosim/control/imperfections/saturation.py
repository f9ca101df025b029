"""Limits signals to a range."""

from __future__ import annotations

from collections.abc import Sequence

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.controllers.joints import saturate
from flexfmu.cosim.control.imperfections.channels import Channel, sampling, section_channels
from flexfmu.cosim.control.imperfections.variables import PerChannel, inputs, outputs, parameters, units
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.imperfections import SaturationSection
from flexfmu.model.symbolic import SymbolicBlock


def saturation(
    channels: Sequence[Channel],
    lower: PerChannel,
    upper: PerChannel,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "saturation",
) -> SymbolicBlock:
    """Build the block y = sat(u): u within [lower, upper], otherwise the nearer limit; without states.

    The limits are tunable parameters ``<channel>.minimum`` and ``<channel>.maximum``.

    Args:
        channels: signals to limit, usually torques.
        lower, upper: limits in the channels' units.
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: a limit isn't finite, the lower one is above the upper one, or the sample time isn't positive.
    """
    # lower limit not above upper limit for every channel
    ports = inputs(channels)
    minima = parameters(channels, "minimum", lower, units(channels), "the lower limit")
    maxima = parameters(channels, "maximum", upper, units(channels), "the upper limit")
    for channel, low, high in zip(channels, minima, maxima, strict=True):
        if low.start is not None and high.start is not None and low.start > high.start:
            raise InputError(
                f"{name}: the lower limit {low.start} {low.unit} of {channel.name} is above the upper one, "
                f"{high.start} {high.unit}; swap them"
            )

    # a function of the input alone, without states
    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        return saturate(u, *split(p, len(channels))), x

    return block(
        name,
        "Saturation",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=ports,
        outputs=outputs(channels),
        parameters=[*minima, *maxima],
    )


@builds(SaturationSection)
def _from_section(section: SaturationSection, context: LoopContext) -> SymbolicBlock:
    return saturation(section_channels(section, context), *section.bounds, **sampling(section, context))
