"""Imperfections of sampled signals: limits, dead zone, backlash, quantisation, encoders, noise and jitter.

Each function builds one block from its law, which acts on every channel alone: u is the signal as it comes, y as it goes on, u_k
that of sample k. What all share: ``channels`` are the signals, with values before the first sample where the law has a memory, and
the options are ``sample_time`` h, the time between samples [s], ``offset``, the first sample instant [s], and ``name``, the block's name.

Numbers of the law are in the channels' units, one for all channels or one for each, and become tunable parameters
``<channel>.<key>``. A ``seed`` is a whole number from 0 to 2^20 - 1 and a fixed parameter ``seed``: random numbers are the same in
Python and in an exported FMU. Below each function stands how a section of the scene file becomes its block.

Raises:
    InputError: there is no channel, a number isn't finite or is out of its range, or the sample time isn't positive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite, pi
from typing import Unpack

import casadi

from flexfmu.cosim.control.blocks.equations import BlockOptions, Vector, split
from flexfmu.cosim.control.controllers.joints import JOINTS, saturate
from flexfmu.cosim.control.imperfections.channels import (
    REFERENCE_KINDS,
    Channel,
    PerChannel,
    channel_block,
    cut,
    initial_parameters,
    joint_channels,
    parameters,
    per_second,
    recall,
    remember,
    repeated,
    sampling,
    section_channels,
    start_values,
    whole_number,
)
from flexfmu.cosim.control.imperfections.random_streams import draw, seed_parameter, seeded
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import check_sampling
from flexfmu.model.scene.imperfections import (
    BacklashSection,
    DeadZoneSection,
    EncoderSection,
    JitterSection,
    NoiseSection,
    QuantisationSection,
    RateLimitSection,
    SaturationSection,
)
from flexfmu.model.symbolic import SymbolicBlock, Variable


def saturation(
    channels: Sequence[Channel],
    lower: PerChannel,
    upper: PerChannel,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """y = sat(u): u within [lower, upper], otherwise the nearer limit.

    Parameters ``<channel>.minimum`` and ``<channel>.maximum``; a lower limit above the upper one is an `InputError`.
    """
    minima = parameters(channels, "minimum", lower, "the lower limit")
    maxima = parameters(channels, "maximum", upper, "the upper limit")
    for channel, low, high in zip(channels, minima, maxima, strict=True):
        if low.start is not None and high.start is not None and low.start > high.start:
            name = options.get("name", "saturation")
            raise InputError(
                f"{name}: the lower limit {low.start} {low.unit} of {channel.name} is above the upper one, "
                f"{high.start} {high.unit}; swap them"
            )

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        return saturate(u, *split(p, len(channels))), x

    return channel_block("saturation", "Saturation", law, channels, [*minima, *maxima], **options)


builds(SaturationSection)(lambda s, c: saturation(section_channels(s, c), *s.bounds, **sampling(s, c)))


def rate_limit(
    channels: Sequence[Channel],
    rising: PerChannel,
    falling: PerChannel | None = None,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """y_k = u_k, limited to y_k-1 - falling h .. y_k-1 + rising h; both rates are zero or positive, per second.

    Before the first sample y is the channel's initial value, or without one the first input. ``falling`` is the rising rate by
    default. Parameters ``<channel>.rising_rate`` and ``<channel>.falling_rate``.
    """
    rates = [per_second(each.unit) for each in channels]
    falling = rising if falling is None else falling
    n, h = len(channels), options["sample_time"]

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        (up, down), initial = split(h * p[: 2 * n], n), p[2 * n :]
        last = recall(x, start_values(channels, initial, u))
        # limit the change since the last sample
        change = u - last
        y = casadi.if_else(change > up, last + up, casadi.if_else(change < -down, last - down, u))
        return y, remember(y)

    numbers = [
        *parameters(channels, "rising_rate", rising, "the fastest rise", minimum=0.0, units=rates),
        *parameters(channels, "falling_rate", falling, "the fastest fall", minimum=0.0, units=rates),
        *initial_parameters(channels),
    ]
    return channel_block("rate_limit", "Rate limit", law, channels, numbers, memory=n, **options)


builds(RateLimitSection)(lambda s, c: rate_limit(section_channels(s, c), s.rate, s.falling_rate, **sampling(s, c)))


def dead_zone(
    channels: Sequence[Channel],
    half_width: PerChannel,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """y = u - sat(u) with the limits ± w: nothing within ± w, and u less w beyond.

    The half width w, zero or positive, is the parameter ``<channel>.half_width``.
    """

    def law(x: Vector, u: Vector, w: Vector) -> tuple[Vector, Vector]:
        return u - saturate(u, -w, w), x

    widths = parameters(channels, "half_width", half_width, "the half width", minimum=0.0)
    return channel_block("dead_zone", "Dead zone", law, channels, widths, **options)


builds(DeadZoneSection)(lambda s, c: dead_zone(section_channels(s, c), s.half_width, **sampling(s, c)))


def backlash(
    channels: Sequence[Channel],
    gap: PerChannel,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """y_k = min(max(y_k-1, u_k - g / 2), u_k + g / 2): a play, as between a joint and the gear of its encoder.

    The output stands still while the input goes through the gap g, zero or positive, the parameter ``<channel>.gap``. At the
    first sample it is in the middle of the gap. M. Nordin and P.-O. Gutman, Controlling mechanical systems with backlash: a
    survey, Automatica 38 (2002), section 3.
    """

    def law(x: Vector, u: Vector, g: Vector) -> tuple[Vector, Vector]:
        last = recall(x, u)
        away = saturate(last - u, -0.5 * g, 0.5 * g)
        # exactly still within the gap; NaN of the input isn't within it
        y = casadi.if_else(away == last - u, last, u + away)
        return y, remember(y)

    gaps = parameters(channels, "gap", gap, "the gap", minimum=0.0)
    return channel_block("backlash", "Backlash", law, channels, gaps, memory=len(channels), **options)


builds(BacklashSection)(lambda s, c: backlash(section_channels(s, c), s.gap, **sampling(s, c)))


def quantisation(
    channels: Sequence[Channel],
    resolution: PerChannel,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """y = q floor(u / q + 1/2), the nearest multiple of the resolution q.

    The error is at most q/2. For a signal that crosses many steps it is approximately white and uniform, of variance
    q²/12 (B. Widrow, I. Kollár, Quantization Noise, 2008, on pseudo-quantization noise). The resolution, zero or positive, is the
    parameter ``<channel>.resolution``; zero switches the quantisation off.
    """

    def law(x: Vector, u: Vector, q: Vector) -> tuple[Vector, Vector]:
        return casadi.if_else(q > 0.0, q * casadi.floor(u / q + 0.5), u), x

    resolutions = parameters(channels, "resolution", resolution, "the resolution", minimum=0.0)
    return channel_block("quantisation", "Quantisation", law, channels, resolutions, **options)


builds(QuantisationSection)(lambda s, c: quantisation(section_channels(s, c), s.resolution, **sampling(s, c)))


def encoder(
    counts_per_turn: PerChannel,
    *,
    window: int = 1,
    joints: Sequence[str] = JOINTS,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """Build the block of incremental encoders: angles to the nearest count, rates by difference.

    With q = 2 pi / counts_per_turn and window w::

        c_k = floor(q_k / q + 1/2),  position = q c_k,  velocity = q (c_k - c_k-w) / (w h)

    so the rate has a resolution of q / (w h) and a delay of w h / 2. Before the first sample the joints are assumed at
    rest. Inputs: ``joint1.position.input``; outputs ``joint1.position`` and ``joint1.velocity``; parameter
    ``joint1.position.counts_per_turn``.

    Args:
        counts_per_turn: counts per turn of the joint, gear ratio and fourfold evaluation of the lines included; at
            least 1.
        window: w, number of sample times that the difference spans, at least 1.
        joints: names of the joints.
    """
    whole_number(f"{options.get('name', 'encoder')}: the window in samples", window, 1)
    angles, rates = joint_channels("position", joints=joints), joint_channels("velocity", joints=joints)
    n, span = len(angles), window * options["sample_time"]

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # angle in whole counts
        resolution = 2.0 * pi / p
        counts = casadi.floor(u / resolution + 0.5)
        # velocity from the difference over the window
        past = recall(x, repeated(counts, window))
        velocity = (counts - past[-n:]) * (resolution / span)
        return casadi.vertcat(resolution * counts, velocity), remember(counts, *cut(past, n * (window - 1)))

    what, late = "the number of counts per turn", {each.name: span / 2.0 for each in rates}
    counts = parameters(angles, "counts_per_turn", counts_per_turn, what, minimum=1.0, units=["1"] * n)
    return channel_block(
        "encoder",
        "Incremental encoders",
        law,
        angles,
        counts,
        memory=window * n,
        latency=late,
        further=rates,
        **options,
    )


builds(EncoderSection)(lambda s, c: encoder(s.counts_per_turn, window=s.window, **sampling(s, c)))


def gaussian_noise(
    channels: Sequence[Channel],
    standard_deviation: PerChannel,
    seed: int,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """y = u + white Gaussian noise, independent for every channel: its numbers depend on channel, block's name and seed alone.

    A normal number is made of two uniform ones, sqrt(-2 ln U) cos(2 pi V) (G. E. P. Box, M. E. Muller, A note on the
    generation of random normal deviates, Annals of Mathematical Statistics 29(2), 1958, pp. 610-611); with
    31 bits its magnitude is at most 6.56. The one-sided power spectral density is 2 h standard_deviation².

    The standard deviation, zero or positive, is the parameter ``<channel>.standard_deviation``.
    """

    def normal(states: Vector) -> tuple[Vector, Vector]:
        radius, states = draw(states)
        angle, states = draw(states)
        return casadi.sqrt(-2.0 * casadi.log(radius)) * casadi.cos(2.0 * pi * angle), states

    scales = parameters(channels, "standard_deviation", standard_deviation, "the standard deviation", minimum=0.0)
    return _noise("Gaussian noise", normal, channels, scales, seed, **options)


def uniform_noise(
    channels: Sequence[Channel],
    half_width: PerChannel,
    seed: int,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """y = u + white noise, uniform in ± half_width and of variance half_width² / 3; independent as `gaussian_noise` is.

    The half width, zero or positive, is the parameter ``<channel>.half_width``.
    """

    def symmetric(states: Vector) -> tuple[Vector, Vector]:
        value, states = draw(states)
        return 2.0 * value - 1.0, states

    scales = parameters(channels, "half_width", half_width, "the half width", minimum=0.0)
    return _noise("Uniform noise", symmetric, channels, scales, seed, **options)


def _noise(
    description: str,
    draws: Callable[[Vector], tuple[Vector, Vector]],
    channels: Sequence[Channel],
    scales: Sequence[Variable],
    seed: int,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """Build the block: inputs plus scaled random numbers."""
    n, name = len(channels), options.get("name", "noise")
    names = [f"{name}/{each.name}" for each in channels]

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        scale, chosen = split(p, n, 1)
        # next random number of each channel's stream
        values, following = draws(recall(x, seeded(names, chosen)))
        return u + scale * values, remember(following)

    numbers = [*scales, seed_parameter(seed, name)]
    return channel_block("noise", description, law, channels, numbers, memory=2 * n, **options)


@builds(NoiseSection)
def _noise_of_section(section: NoiseSection, context: LoopContext) -> SymbolicBlock:
    channels, when, seed = section_channels(section, context), sampling(section, context), section.seed
    if section.half_width is not None:
        return uniform_noise(channels, section.half_width, seed, name=context.name, **when)
    return gaussian_noise(channels, section.standard_deviation or 0.0, seed, name=context.name, **when)


def jitter(
    channels: Sequence[Channel],
    time: float,
    seed: int,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """Build the block: the sample at t_k is up to ``time`` old, at random; the same for all channels.

    With U uniform in (0, 1)::

        y_k = u_k - U_k time / h (u_k - u_k-1)  ≈  u(t_k - U_k time)

    by linear interpolation between this sample and the last one; the mean delay is time / 2. Channels with separate
    clocks need separate blocks with different names. Before the first sample a signal has the channel's initial value,
    or without one the value of the first sample. The largest delay [s], from zero to the sample time, is the tunable parameter
    ``largest_delay``.
    """
    n, h, name = len(channels), options["sample_time"], options.get("name", "jitter")
    check_sampling(h, options.get("offset", 0.0), name)
    if not (isfinite(time) and 0.0 <= time <= h):
        raise InputError(f"{name}: the jitter must be zero to the sample time, {h} s, got {time} s")
    largest = Variable("largest_delay", "s", "Largest delay", "parameter", time, 0.0, h, tunable=True)

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # memory: the last sample (n,) and the random stream
        late, chosen, initial = p[0] / h, p[1], p[2:]
        start = casadi.vertcat(start_values(channels, initial, u), seeded([name], chosen))
        last, states = split(recall(x, start), n, 2)
        value, states = draw(states)
        # linear interpolation at a random time before the sample instant
        return u - late * value * (u - last), remember(u, states)

    numbers = [largest, seed_parameter(seed, name), *initial_parameters(channels)]
    delays = {each.name: time / 2.0 for each in channels} if time else {}
    return channel_block("jitter", "Sample jitter", law, channels, numbers, memory=n + 2, latency=delays, **options)


builds(JitterSection)(
    lambda s, c: jitter(section_channels(s, c, REFERENCE_KINDS), s.time, s.seed, name=c.name, **sampling(s, c))
)
