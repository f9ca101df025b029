"""Limits the rate of change of signals."""

from __future__ import annotations

from collections.abc import Sequence

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.imperfections.channels import Channel, empty, recall, remember, sampling, section_channels
from flexfmu.cosim.control.imperfections.variables import (
    PerChannel,
    initial_parameters,
    inputs,
    outputs,
    parameters,
    per_second,
    start_values,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.model.scene.imperfections import RateLimitSection
from flexfmu.model.symbolic import SymbolicBlock


def rate_limit(
    channels: Sequence[Channel],
    rising: PerChannel,
    falling: PerChannel | None = None,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "rate_limit",
) -> SymbolicBlock:
    """Build the block y_k = u_k, limited to y_k-1 - falling h .. y_k-1 + rising h with the sample time h.

    Before the first sample y is the channel's initial value, or without one the first input. The limits are tunable
    parameters ``<channel>.rising_rate`` and ``<channel>.falling_rate``.

    Args:
        channels: signals to limit.
        rising: largest rising rate in the channels' units per second, zero or positive.
        falling: largest falling rate, likewise; None for the rising rate.
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: a rate is negative or not finite, or the sample time isn't positive.
    """
    ports = inputs(channels)
    rates = [per_second(each.unit) for each in channels]
    falling = rising if falling is None else falling
    n, h = len(channels), sample_time

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        (up, down), initial = split(h * p[: 2 * n], n), p[2 * n :]
        last = recall(x, start_values(channels, initial, u))
        # limit the change since the last sample
        change = u - last
        y = casadi.if_else(change > up, last + up, casadi.if_else(change < -down, last - down, u))
        return y, remember(y)

    return block(
        name,
        "Rate limit",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=ports,
        outputs=outputs(channels),
        parameters=[
            *parameters(channels, "rising_rate", rising, rates, "the fastest rise", minimum=0.0),
            *parameters(channels, "falling_rate", falling, rates, "the fastest fall", minimum=0.0),
            *initial_parameters(channels),
        ],
        states=empty(n),
    )


@builds(RateLimitSection)
def _from_section(section: RateLimitSection, context: LoopContext) -> SymbolicBlock:
    channels = section_channels(section, context)
    return rate_limit(channels, section.rate, section.falling_rate, **sampling(section, context))
