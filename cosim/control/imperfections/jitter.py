"""Sample jitter: random variation of a converter's sample instants."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.imperfections.channels import (
    REFERENCE_KINDS,
    Channel,
    empty,
    recall,
    remember,
    sampling,
    section_channels,
)
from flexfmu.cosim.control.imperfections.random_streams import Streams, draw, seed_parameter, seeded
from flexfmu.cosim.control.imperfections.variables import initial_parameters, inputs, outputs, start_values
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import check_sampling
from flexfmu.model.scene.imperfections import JitterSection
from flexfmu.model.symbolic import SymbolicBlock, Variable


def jitter(
    channels: Sequence[Channel],
    time: float,
    seed: int,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "jitter",
) -> SymbolicBlock:
    """Build the block: the sample at t_k is up to ``time`` old, at random; the same for all channels.

    With sample time h and U uniform in (0, 1)::

        y_k = u_k - U_k time / h (u_k - u_k-1)  ≈  u(t_k - U_k time)

    by linear interpolation between this sample and the last one; the mean delay is time / 2. Channels with separate
    clocks need separate blocks with different names. Before the first sample a signal has the channel's initial value,
    or without one the value of the first sample. Parameters: ``largest_delay``, tunable, and ``seed``, fixed.

    Args:
        channels: signals to sample.
        time: largest delay [s], from zero to the sample time.
        seed: whole number from 0 to 2^20 - 1.
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: the time or the seed is out of range, or the sample time isn't positive.
    """
    check_sampling(sample_time, offset, name)
    if not (isfinite(time) and 0.0 <= time <= sample_time):
        raise InputError(f"{name}: the jitter must be zero to the sample time, {sample_time} s, got {time} s")
    ports, n = inputs(channels), len(channels)
    largest = Variable("largest_delay", "s", "Largest delay", "parameter", time, 0.0, sample_time, tunable=True)

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # memory: the last sample (n,) and the random stream
        late, chosen, initial = p[0] / sample_time, p[1], p[2:]
        start = casadi.vertcat(start_values(channels, initial, u), seeded([name], chosen).states)
        last, states = split(recall(x, start), n, 2)
        value, streams = draw(Streams.of(states))
        # linear interpolation at a random time before the sample instant
        return u - late * value * (u - last), remember(u, streams.states)

    return block(
        name,
        "Sample jitter",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=ports,
        outputs=outputs(channels),
        parameters=[largest, seed_parameter(seed, name), *initial_parameters(channels)],
        states=empty(n + 2),
        latency={each.name: time / 2.0 for each in channels} if time else {},
    )


@builds(JitterSection)
def _from_section(section: JitterSection, context: LoopContext) -> SymbolicBlock:
    channels = section_channels(section, context, REFERENCE_KINDS)
    return jitter(channels, section.time, section.seed, name=context.name, **sampling(section, context))
