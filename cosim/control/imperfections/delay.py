"""Delay of signals: a line of whole samples, and behind it a digital filter that delays by a fraction of one.

`whole_delay` and `delay` build the block from ``channels``, the signals, with their values before the first sample where the block has no
direct feedthrough; the options are ``sample_time``, the time between samples [s], ``offset``, the first sample instant [s], and ``name``,
the block's name. T. I. Laakso, V. Välimäki, M. Karjalainen, U. K. Laine, Splitting the unit delay: tools for fractional delay filter design,
IEEE Signal Processing Magazine 13(1), 1996, pp. 30-60.

Raises:
    InputError: a delay is negative, not finite or too short for its filter, a channel has no initial value where it needs one, or
        the sample time isn't positive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, floor, isfinite, prod
from typing import Unpack

import casadi

from flexfmu.cosim.control.blocks.equations import BlockOptions, Vector
from flexfmu.cosim.control.controllers.joints import JOINTS
from flexfmu.cosim.control.imperfections.channels import (
    REFERENCE_KINDS,
    Channel,
    channel_block,
    cut,
    initial_parameters,
    inputs,
    joint_channels,
    recall,
    remember,
    repeated,
    require_initial,
    sampling,
    section_channels,
    start_values,
    whole_number,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import check_sampling
from flexfmu.model.scene import imperfections as scene
from flexfmu.model.symbolic import SymbolicBlock

VECTORISED_FROM = 100
"""Size of the memory from which vector operations (MX) are faster than scalar ones (SX)."""

WHOLE = 1e-12
"""Relative tolerance within which a delay is a whole number of samples: time / sample time is rounded."""

HIGHEST_ORDER = 10
"""Highest order; higher ones don't improve signals of machines."""


@dataclass(frozen=True)
class DelayFilter:
    """The filter y_k = sum_{i >= 0} b_i u_k-whole-i - sum_{i >= 1} a_i y_k-i.

    Attributes:
        whole: delay before the filter, in samples.
        numerator: b_0, b_1, ...; neither the first nor the last one is zero.
        denominator: a_1, a_2, ...; sum b = 1 + sum a, so the gain at zero frequency is 1.
    """

    whole: int
    numerator: tuple[float, ...] = (1.0,)
    denominator: tuple[float, ...] = ()

    @property
    def depth(self) -> int:
        """Number of past inputs that the filter needs."""
        return self.whole + len(self.numerator) - 1

    @property
    def samples(self) -> float:
        """Group delay at zero frequency, in samples."""
        b, a = self.numerator, (1.0, *self.denominator)
        slopes = (sum(i * weight for i, weight in enumerate(weights)) / sum(weights) for weights in (b, a))
        return self.whole + next(slopes) - next(slopes)


@dataclass(frozen=True)
class Lagrange:
    """Lagrange interpolation through order + 1 samples, for a delay D: h_k = prod_{i != k} (D - i) / (k - i).

    The frequency response is maximally flat at zero frequency, and its magnitude nowhere exceeds 1 (Laakso et al. 1996,
    on maximally flat FIR filters). The shortest delay is (order - 1) / 2 samples.

    Attributes:
        order: N, from 1 (linear interpolation) to `HIGHEST_ORDER`.

    Raises:
        InputError: the order is no whole number or is out of range.
    """

    order: int

    def __post_init__(self) -> None:
        whole_number("the order of Lagrange interpolation", self.order, 1, HIGHEST_ORDER)

    def design(self, samples: float) -> DelayFilter:
        """Return the filter whose delay lies in the middle interval between its samples.

        Raises:
            InputError: the delay is below (order - 1) / 2 samples.
        """
        # whole samples before the filter
        nodes = range(self.order + 1)
        middle = (self.order - 1) / 2
        _check_shortest(samples, middle, f"Lagrange interpolation of order {self.order}")
        whole = floor(samples - middle)
        rest = samples - whole
        weights = tuple(prod((rest - i) / (k - i) for i in nodes if i != k) for k in nodes)
        # weights of zero at both ends need no memory
        used = [i for i, weight in enumerate(weights) if weight]
        return DelayFilter(whole + used[0], weights[used[0] : used[-1] + 1])


@dataclass(frozen=True)
class Thiran:
    """Thiran's all-pass, whose group delay D is maximally flat at zero frequency ::

        a_k = (-1)^k C(N, k) prod_{i=0..N} (D - N + i) / (D - N + k + i)

    Its gain is 1 at all frequencies, but its step response ripples. J.-P. Thiran, Recursive digital filters with
    maximally flat group delay, IEEE Transactions on Circuit Theory 18(6), 1971, pp. 659-664; as an all-pass in
    Laakso et al. 1996. The filter's delay D is N - 1/2 to N + 1/2 samples, where it is stable and most accurate.

    Attributes:
        order: N, from 1 to `HIGHEST_ORDER`.

    Raises:
        InputError: the order is no whole number or is out of range.
    """

    order: int

    def __post_init__(self) -> None:
        whole_number("the order of Thiran's all-pass", self.order, 1, HIGHEST_ORDER)

    def design(self, samples: float) -> DelayFilter:
        """Return the filter whose delay is closest to its order.

        Raises:
            InputError: the delay is below order - 1/2 samples.
        """
        # whole samples before the filter
        n = self.order
        _check_shortest(samples, n - 0.5, f"Thiran's all-pass of order {n}")
        whole = floor(samples - n + 0.5)
        excess = samples - whole - n
        # coefficients of the denominator; the numerator has them in reverse order
        a = [
            (-1) ** k * comb(n, k) * prod((excess + i) / (excess + k + i) for i in range(n + 1))
            for k in range(1, n + 1)
        ]
        if not any(a):
            return DelayFilter(whole + n)
        return DelayFilter(whole, (*reversed(a), 1.0), tuple(a))


Interpolation = Lagrange | Thiran
"""A rule that interpolates a signal between its samples."""


def _check_shortest(samples: float, shortest: float, what: str) -> None:
    if not samples >= shortest:
        raise InputError(
            f"a delay of {samples:g} samples is too short for {what}, which needs at least {shortest:g}; "
            "take a lower order, linear interpolation or a shorter sample time"
        )


LINEAR = Lagrange(1)
"""Linear interpolation."""


def whole_delay(channels: Sequence[Channel], samples: int, **options: Unpack[BlockOptions]) -> SymbolicBlock:
    """y_k = u_k-n, exact, for ``samples`` n, zero or positive; the first n outputs are the channels' initial values."""
    what = f"{options.get('name', 'delay')}: the delay in samples"
    whole = whole_number(what, samples, 0, hint="`delay` takes any time in seconds")
    return _delay_line(channels, DelayFilter(whole), **options)


def delay(
    channels: Sequence[Channel],
    time: float,
    *,
    interpolation: Interpolation = LINEAR,
    **options: Unpack[BlockOptions],
) -> SymbolicBlock:
    """y(t_k) = u(t_k - time), interpolated between the samples; a whole number of samples is exact.

    A delay of whole samples before the filter leaves no direct feedthrough and breaks algebraic loops; with `LINEAR`
    these are delays of one sample and more. Before the first sample signals have the channels' initial values, or
    without these the value of the first sample.

    Args:
        time: the delay [s], zero or positive.
        interpolation: `Lagrange` of any order, `LINEAR` being the first, or the all-pass `Thiran`.
    """
    name, h = options.get("name", "delay"), options["sample_time"]
    check_sampling(h, 0.0, name)
    if not (isfinite(time) and time >= 0.0):
        raise InputError(f"{name}: the delay must be zero or positive, got {time} s")
    samples = time / h
    whole = float(round(samples))
    design = interpolation.design(whole if abs(samples - whole) <= WHOLE * samples else samples)
    return _delay_line(channels, design, **options)


def _delay_line(channels: Sequence[Channel], design: DelayFilter, **options: Unpack[BlockOptions]) -> SymbolicBlock:
    """Build the block of a delay line and a filter behind it, for every channel.

    The filter acts on differences from the oldest sample, so that a constant signal stays the same to the last bit.
    """
    inputs(channels)  # a block without channels is refused first
    if design.whole:
        require_initial(channels, options.get("name", "delay"))
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
    return channel_block(
        "delay",
        f"Delay by {design.samples:.9g} samples",
        equations,
        channels,
        initial_parameters(channels) if depth else (),
        memory=size,
        latency={each.name: design.samples * options["sample_time"] for each in channels} if design.samples else {},
        symbol=casadi.MX if size >= VECTORISED_FROM else casadi.SX,
        **options,
    )


@builds(scene.DelaySection)
def _from_section(section: scene.DelaySection, context: LoopContext) -> SymbolicBlock:
    rule = section.interpolation
    interpolation = Thiran(rule.order) if isinstance(rule, scene.ThiranSection) else Lagrange(rule.order)
    channels = section_channels(section, context, REFERENCE_KINDS)
    if section.known:
        references = [f"{each}.reference" for each in JOINTS]
        channels += joint_channels(section.signal, context.before(section.signal), references)
    return delay(channels, section.time, interpolation=interpolation, **sampling(section, context))
