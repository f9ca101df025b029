"""Delay of signals by whole samples or fractions of them."""

from __future__ import annotations

from collections.abc import Sequence

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.joints import JOINTS
from flexfmu.cosim.control.imperfections.channels import (
    REFERENCE_KINDS,
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
from flexfmu.cosim.control.imperfections.delay_filter import (
    LINEAR,
    DelayFilter,
    Interpolation,
    Lagrange,
    Thiran,
    delay_in_samples,
)
from flexfmu.cosim.control.imperfections.variables import (
    initial_parameters,
    inputs,
    outputs,
    require_initial,
    start_values,
    whole_number,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.model.scene import imperfections as scene
from flexfmu.model.symbolic import SymbolicBlock

VECTORISED_FROM = 100
"""Size of the memory from which vector operations (MX) are faster than scalar ones (SX)."""


def whole_delay(
    channels: Sequence[Channel],
    samples: int,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "delay",
) -> SymbolicBlock:
    """Build the block y_k = u_k-n, exact; the first n outputs are the channels' initial values.

    Args:
        channels: signals to delay, with initial values unless n = 0.
        samples: n, zero or positive.
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: n isn't a whole number or is negative, a channel has no initial value, or the sample time isn't
            positive.
    """
    whole = whole_number(f"{name}: the delay in samples", samples, 0, hint="`delay` takes any time in seconds")
    return _delay_line(channels, DelayFilter(whole), sample_time, offset, name)


def delay(
    channels: Sequence[Channel],
    time: float,
    *,
    sample_time: float,
    offset: float = 0.0,
    interpolation: Interpolation = LINEAR,
    name: str = "delay",
) -> SymbolicBlock:
    """Build the block y(t_k) = u(t_k - time), interpolated between the samples; a whole number of samples is exact.

    A delay of whole samples before the filter leaves no direct feedthrough and breaks algebraic loops; with `LINEAR`
    these are delays of one sample and more. Before the first sample signals have the channels' initial values, or
    without these the value of the first sample.

    Args:
        channels: signals to delay, with initial values where the block has no direct feedthrough.
        time: the delay [s], zero or positive.
        sample_time, offset: [s].
        interpolation: `Lagrange` of any order, `LINEAR` being the first, or the all-pass `Thiran`.
        name: name of the block.

    Raises:
        InputError: the delay is negative, not finite or too short for the interpolation, a channel has no initial
            value, or the sample time isn't positive.
    """
    design = interpolation.design(delay_in_samples(time, sample_time, name))
    return _delay_line(channels, design, sample_time, offset, name)


def _delay_line(
    channels: Sequence[Channel], design: DelayFilter, sample_time: float, offset: float, name: str
) -> SymbolicBlock:
    """Build the block of a delay line and a filter behind it, for every channel.

    The filter acts on differences from the oldest sample, so that a constant signal stays the same to the last bit.
    """
    ports = inputs(channels)
    if design.whole:
        require_initial(channels, name)
    n, depth, order = len(channels), design.depth, len(design.denominator)

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        memory = recall(x, repeated(start_values(channels, p, u), depth + order)) if depth else x
        past, response = cut(memory, n * depth, n * order)
        # differences from the oldest sample
        signal: Vector = casadi.vertcat(u, past)
        last = signal[n * depth :]
        y = last
        # numerator of the filter, then its denominator
        for i, weight in enumerate(design.numerator[:-1], start=design.whole):
            y += weight * (signal[n * i : n * (i + 1)] - last)
        for i, weight in enumerate(design.denominator):
            y -= weight * (response[n * i : n * (i + 1)] - last)
        if not depth:
            return y, x
        return y, remember(*cut(signal, n * depth), *cut(casadi.vertcat(y, response), n * order))

    size = n * (depth + order)
    return block(
        name,
        f"Delay by {design.samples:.9g} samples",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=ports,
        outputs=outputs(channels),
        parameters=initial_parameters(channels) if depth else (),
        states=empty(size) if depth else (),
        symbol=casadi.MX if size >= VECTORISED_FROM else casadi.SX,
        latency={each.name: design.samples * sample_time for each in channels} if design.samples else {},
    )


@builds(scene.DelaySection)
def _from_section(section: scene.DelaySection, context: LoopContext) -> SymbolicBlock:
    # the interpolation of the section
    interpolation: Interpolation
    match section.interpolation:
        case scene.LagrangeSection(order=order):
            interpolation = Lagrange(order)
        case scene.ThiranSection(order=order):
            interpolation = Thiran(order)
        case scene.LinearSection():
            interpolation = LINEAR
    channels = section_channels(section, context, REFERENCE_KINDS)
    if section.known:
        channels += joint_channels(
            section.signal, context.before(section.signal), [f"{each}.reference" for each in JOINTS]
        )
    return delay(channels, section.time, interpolation=interpolation, **sampling(section, context))
