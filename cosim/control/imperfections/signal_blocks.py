"""Imperfections of sampled signals: limits, dead zone, backlash, quantisation, encoders, noise and jitter.

Each function builds the block of a section of the scene file from its law, which acts on every channel alone: u is the signal as it
comes, y as it goes on, u_k that of sample k, and h the sample time. Numbers of the law are in the channels' units and become tunable
parameters ``<channel>.<key>``. A ``seed`` is a fixed parameter ``seed``: random numbers are the same in Python and in an exported FMU to the last bit, since their integers are exact.

Their generator combines two multiplicative congruential generators with moduli below 2^31; its period is 2.3e18: P.
L'Ecuyer, Efficient and portable combined random number generators, Communications of the ACM 31(6), 1988, pp. 742-751.
Products stay below 2^48, so doubles hold them exactly.

Every stream has a name, whose hash is its start state, and a seed, which skips seed * 2^40 numbers (P. L'Ecuyer,
S. Côté, Implementing a random number package with splitting facilities, ACM Transactions on Mathematical Software
17(1), 1991, pp. 98-111). So a signal's random numbers don't depend on the other signals of its block, different seeds
use disjoint parts of a stream, and differently named streams start at unrelated states.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from math import pi
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, split
from flexfmu.cosim.control.controllers.joints import saturate
from flexfmu.cosim.control.imperfections.channels import REFERENCE_KINDS, Channels, cut, recall, remember, repeated
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene import imperfections
from flexfmu.model.symbolic import SymbolicBlock, Variable

MODULI = (2147483563, 2147483399)
MULTIPLIERS = (40014, 40692)

JUMP = 2**40
"""Uniform random numbers from one seed to the next: 127 days at 100 kHz."""

SEED_BITS = 20
LARGEST_SEED = 2**SEED_BITS - 1

_HALF = 2**16


@builds(imperfections.SaturationSection)
def saturation(s: imperfections.SaturationSection, context: LoopContext) -> SymbolicBlock:
    """y = sat(u): u within its limits, otherwise the nearer one; parameters ``<channel>.minimum``, ``<channel>.maximum``."""
    channels, (lower, upper) = Channels(s, context), s.bounds

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        return saturate(u, *split(p, len(channels))), x

    minima = channels.numbers("minimum", lower, "the lower limit")
    maxima = channels.numbers("maximum", upper, "the upper limit")
    return channels.block("Saturation", law, [*minima, *maxima])


@builds(imperfections.RateLimitSection)
def rate_limit(s: imperfections.RateLimitSection, context: LoopContext) -> SymbolicBlock:
    """y_k = u_k, limited to y_k-1 - falling h .. y_k-1 + rising h.

    Before the first sample y is the channel's initial value, or without one the first input. Parameters ``<channel>.rising_rate``
    and ``<channel>.falling_rate``.
    """
    channels = Channels(s, context)
    n, h = len(channels), channels.h

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        (up, down), initial = split(h * p[: 2 * n], n), p[2 * n :]
        last = recall(x, channels.start(initial, u))
        # limit the change since the last sample
        change = u - last
        y = casadi.if_else(change > up, last + up, casadi.if_else(change < -down, last - down, u))
        return y, remember(y)

    rise = channels.numbers("rising_rate", s.rate, "the fastest rise", minimum=0.0, unit="/s")
    fall = channels.numbers("falling_rate", s.falling_rate or s.rate, "the fastest fall", minimum=0.0, unit="/s")
    return channels.block("Rate limit", law, [*rise, *fall, *channels.starts], memory=n)


@builds(imperfections.DeadZoneSection)
def dead_zone(s: imperfections.DeadZoneSection, context: LoopContext) -> SymbolicBlock:
    """y = u - sat(u) with the limits ± w: nothing within ± w, and u less w beyond; w is the parameter ``<channel>.half_width``."""

    def law(x: Vector, u: Vector, w: Vector) -> tuple[Vector, Vector]:
        return u - saturate(u, -w, w), x

    channels = Channels(s, context)
    return channels.block("Dead zone", law, channels.numbers("half_width", s.half_width, "the half width", minimum=0.0))


@builds(imperfections.BacklashSection)
def backlash(s: imperfections.BacklashSection, context: LoopContext) -> SymbolicBlock:
    """y_k = min(max(y_k-1, u_k - g / 2), u_k + g / 2): a play, as between a joint and the gear of its encoder.

    The output stands still while the input goes through the gap g, the parameter ``<channel>.gap``. At the first sample it is in
    the middle of the gap. M. Nordin and P.-O. Gutman, Controlling mechanical systems with backlash: a survey, Automatica 38
    (2002), section 3.
    """

    def law(x: Vector, u: Vector, g: Vector) -> tuple[Vector, Vector]:
        last = recall(x, u)
        away = saturate(last - u, -0.5 * g, 0.5 * g)
        # exactly still within the gap; NaN of the input isn't within it
        y = casadi.if_else(away == last - u, last, u + away)
        return y, remember(y)

    channels = Channels(s, context)
    gaps = channels.numbers("gap", s.gap, "the gap", minimum=0.0)
    return channels.block("Backlash", law, gaps, memory=len(channels))


@builds(imperfections.QuantisationSection)
def quantisation(s: imperfections.QuantisationSection, context: LoopContext) -> SymbolicBlock:
    """y = q floor(u / q + 1/2), the nearest multiple of the resolution q, the parameter ``<channel>.resolution``; zero switches it off.

    The error is at most q/2. For a signal that crosses many steps it is approximately white and uniform, of variance
    q²/12 (B. Widrow, I. Kollár, Quantization Noise, 2008, on pseudo-quantization noise).
    """

    def law(x: Vector, u: Vector, q: Vector) -> tuple[Vector, Vector]:
        return casadi.if_else(q > 0.0, q * casadi.floor(u / q + 0.5), u), x

    channels = Channels(s, context)
    resolutions = channels.numbers("resolution", s.resolution, "the resolution", minimum=0.0)
    return channels.block("Quantisation", law, resolutions)


@builds(imperfections.EncoderSection)
def encoder(s: imperfections.EncoderSection, context: LoopContext) -> SymbolicBlock:
    """Build the block of incremental encoders: angles to the nearest count, rates by difference.

    With q = 2 pi / counts_per_turn and window w::

        c_k = floor(q_k / q + 1/2),  position = q c_k,  velocity = q (c_k - c_k-w) / (w h)

    so the rate has a resolution of q / (w h) and a delay of w h / 2. Before the first sample the joints are assumed at
    rest. Inputs: ``joint1.position.input``; outputs ``joint1.position`` and ``joint1.velocity``; parameter
    ``joint1.position.counts_per_turn``: counts per turn of the joint, gear ratio and fourfold evaluation of the lines included.
    """
    channels = Channels(s, context)
    n, span = len(channels), s.window * channels.h

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # angle in whole counts
        resolution = 2.0 * pi / p
        counts = casadi.floor(u / resolution + 0.5)
        # velocity from the difference over the window
        past = recall(x, repeated(counts, s.window))
        velocity = (counts - past[-n:]) * (resolution / span)
        return casadi.vertcat(resolution * counts, velocity), remember(counts, *cut(past, n * (s.window - 1)))

    what, angles, late = "the number of counts per turn", channels.inputs, [0.0] * n + [span / 2.0] * n
    counts = channels.numbers("counts_per_turn", s.counts_per_turn, what, minimum=1.0, unit="1")
    channels.add("velocity")
    return channels.block("Incremental encoders", law, counts, memory=s.window * n, latency=late, inputs=angles)


@builds(imperfections.NoiseSection)
def noise(s: imperfections.NoiseSection, context: LoopContext) -> SymbolicBlock:
    """y = u + white noise, independent for every channel: its numbers depend on channel, block's name and seed alone.

    Uniform noise in ± ``half_width`` has the variance half_width² / 3. A normal number is made of two uniform ones,
    sqrt(-2 ln U) cos(2 pi V) (G. E. P. Box, M. E. Muller, A note on the generation of random normal deviates, Annals of
    Mathematical Statistics 29(2), 1958, pp. 610-611); with 31 bits its magnitude is at most 6.56. The one-sided power spectral
    density is 2 h standard_deviation². Parameters ``<channel>.half_width``, or ``<channel>.standard_deviation``.
    """
    channels, is_uniform = Channels(s, context), s.half_width is not None
    n, names = len(channels), [f"{context.name}/{each.name}" for each in channels.outputs]

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        scale, chosen = split(p, n, 1)
        # next random number of each channel's stream
        value, states = draw(recall(x, seeded(names, chosen)))
        if is_uniform:
            return u + scale * (2.0 * value - 1.0), remember(states)
        angle, states = draw(states)
        normal = casadi.sqrt(-2.0 * casadi.log(value)) * casadi.cos(2.0 * pi * angle)
        return u + scale * normal, remember(states)

    key, what = ("half_width", "the half width") if is_uniform else ("standard_deviation", "the standard deviation")
    scales = channels.numbers(key, s.half_width or s.standard_deviation or 0.0, what, minimum=0.0)
    title = "Uniform noise" if is_uniform else "Gaussian noise"
    return channels.block(title, law, [*scales, _seed_parameter(s.seed)], memory=2 * n)


@builds(imperfections.JitterSection)
def jitter(s: imperfections.JitterSection, context: LoopContext) -> SymbolicBlock:
    """Build the block: the sample at t_k is up to ``time`` old, at random; the same for all channels.

    With U uniform in (0, 1)::

        y_k = u_k - U_k time / h (u_k - u_k-1)  ≈  u(t_k - U_k time)

    by linear interpolation between this sample and the last one; the mean delay is time / 2. Before the first sample a signal has
    the channel's initial value, or without one the value of the first sample. The largest delay [s], from zero to the sample time,
    is the tunable parameter ``largest_delay``.

    Raises:
        InputError: the time is above the sample time.
    """
    channels, name = Channels(s, context, REFERENCE_KINDS), context.name
    n, h = len(channels), channels.h
    if s.time > h:
        raise InputError(f"{name}: the jitter must be zero to the sample time, {h} s, got {s.time} s")
    largest = Variable("largest_delay", "s", "Largest delay", "parameter", s.time, 0.0, h, tunable=True)

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # memory: the last sample (n,) and the random stream
        late, chosen, initial = p[0] / h, p[1], p[2:]
        start = casadi.vertcat(channels.start(initial, u), seeded([name], chosen))
        last, states = split(recall(x, start), n, 2)
        value, states = draw(states)
        # linear interpolation at a random time before the sample instant
        return u - late * value * (u - last), remember(u, states)

    numbers = [largest, _seed_parameter(s.seed), *channels.starts]
    return channels.block("Sample jitter", law, numbers, memory=n + 2, latency=s.time / 2.0)


def start_states(name: str) -> tuple[int, int]:
    """Return the start states of a named stream with seed 0."""
    digest = sha256(name.encode()).digest()
    first, second = (int.from_bytes(digest[i : i + 8], "big") for i in (0, 8))
    return 1 + first % (MODULI[0] - 1), 1 + second % (MODULI[1] - 1)


def seeded(names: Sequence[str], seed: Vector) -> Vector:
    """Return the states of n named streams for a seed (scalar), a whole number from 0 to `LARGEST_SEED`.

    They are whole numbers (2 n,): first those of all first congruential generators, then those of all second ones.
    """
    starts = np.array([start_states(name) for name in names], dtype=float).T
    jumps = [_jump(seed, multiplier, modulus) for multiplier, modulus in zip(MULTIPLIERS, MODULI, strict=True)]
    return casadi.vertcat(*map(_long_product, jumps, map(casadi.DM, starts), MODULI))


def draw(states: Vector) -> tuple[Vector, Vector]:
    """Draw one number of each stream, uniform in (0, 1); return the numbers (n,) and the next states (2 n,)."""
    first, second = (
        _remainder(multiplier * state, modulus)
        for state, multiplier, modulus in zip(split(states, states.numel() // 2), MULTIPLIERS, MODULI, strict=True)
    )
    difference = first - second
    whole = casadi.if_else(difference < 1.0, difference + (MODULI[0] - 1), difference)
    return whole / MODULI[0], casadi.vertcat(first, second)


def _seed_parameter(seed: int) -> Variable:
    """Return the fixed parameter ``seed``."""
    return Variable("seed", "1", "Number of the random experiment", "parameter", float(seed), 0.0, float(LARGEST_SEED))


def _jump(seed: Vector, multiplier: int, modulus: int) -> Vector:
    """Return multiplier^(JUMP seed) modulo the modulus, by the seed's binary digits."""
    result: Any = 1.0
    rest = casadi.floor(seed)
    # square-and-multiply: the powers are constants, the digits select among them
    for bit in range(SEED_BITS):
        factor = pow(multiplier, JUMP << bit, modulus)
        half = casadi.floor(rest / 2.0)
        digit = rest - 2.0 * half
        result = _long_product(1.0 + digit * (factor - 1.0), result, modulus)
        rest = half
    return result


def _long_product(a: Vector, b: Vector, modulus: int) -> Vector:
    """Return a b modulo the modulus for whole a and b below it; b is split in two, so that no product exceeds 2^48."""
    upper = casadi.floor(b / _HALF)
    lower = b - _HALF * upper
    return _remainder(_HALF * _remainder(a * upper, modulus) + a * lower, modulus)


def _remainder(value: Vector, modulus: int) -> Vector:
    """Return the exact remainder of whole numbers below 2^48 divided by a modulus between 2^30 and 2^31.

    The quotient is below 2^18, so its rounding error is below 2^-35. Unless it is whole, it is more than 2^-31 away
    from a whole number, so `floor` finds the right one.
    """
    return value - modulus * casadi.floor(value / modulus)
