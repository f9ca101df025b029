"""Delay of signals: a line of whole samples, and behind it a digital filter that delays by a fraction of one.

T. I. Laakso, V. Välimäki, M. Karjalainen, U. K. Laine, Splitting the unit delay: tools for fractional delay filter design,
IEEE Signal Processing Magazine 13(1), 1996, pp. 30-60.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, comb, floor, prod

import casadi

from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.imperfections.channels import REFERENCE_KINDS, Channels, cut, recall, remember, repeated
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.imperfections import DelaySection
from flexfmu.model.symbolic import SymbolicBlock, Variable

VECTORISED_FROM = 100
"""Size of the memory from which vector operations (MX) are faster than scalar ones (SX)."""

WHOLE = 1e-12
"""Relative tolerance within which a delay is a whole number of samples: time / sample time is rounded."""


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


def lagrange(order: int, samples: float) -> DelayFilter:
    """Lagrange interpolation through order + 1 samples, for a delay D: h_k = prod_{i != k} (D - i) / (k - i).

    The delay lies in the middle interval between these samples, where the frequency response is maximally flat at zero frequency, and
    its magnitude nowhere exceeds 1 (Laakso et al. 1996, on maximally flat FIR filters). The shortest delay is (order - 1) / 2 samples.

    Raises:
        InputError: the delay is shorter.
    """
    # whole samples before the filter
    nodes, middle = range(order + 1), (order - 1) / 2
    _check_shortest(samples, middle, f"Lagrange interpolation of order {order}")
    whole = floor(samples - middle)
    rest = samples - whole
    weights = tuple(prod((rest - i) / (k - i) for i in nodes if i != k) for k in nodes)
    # weights of zero at both ends need no memory
    used = [i for i, weight in enumerate(weights) if weight]
    return DelayFilter(whole + used[0], weights[used[0] : used[-1] + 1])


def thiran(order: int, samples: float) -> DelayFilter:
    """Thiran's all-pass, whose group delay D is maximally flat at zero frequency ::

        a_k = (-1)^k C(N, k) prod_{i=0..N} (D - N + i) / (D - N + k + i)

    Its gain is 1 at all frequencies, but its step response ripples. J.-P. Thiran, Recursive digital filters with
    maximally flat group delay, IEEE Transactions on Circuit Theory 18(6), 1971, pp. 659-664; as an all-pass in
    Laakso et al. 1996. The filter's delay D is N - 1/2 to N + 1/2 samples, where it is stable and most accurate.

    Raises:
        InputError: the delay is below order - 1/2 samples.
    """
    # whole samples before the filter
    _check_shortest(samples, order - 0.5, f"Thiran's all-pass of order {order}")
    whole = floor(samples - order + 0.5)
    excess = samples - whole - order
    # coefficients of the denominator; the numerator has them in reverse order
    a = [
        (-1) ** k * comb(order, k) * prod((excess + i) / (excess + k + i) for i in range(order + 1))
        for k in range(1, order + 1)
    ]
    return DelayFilter(whole, (*reversed(a), 1.0), tuple(a)) if any(a) else DelayFilter(whole + order)


def _check_shortest(samples: float, shortest: float, what: str) -> None:
    if not samples >= shortest:
        raise InputError(
            f"a delay of {samples:g} samples is too short for {what}, which needs at least {shortest:g}; "
            "take a lower order, linear interpolation or a shorter sample time"
        )


@builds(DelaySection)
def delay(s: DelaySection, context: LoopContext) -> SymbolicBlock:
    """y(t_k) = u(t_k - time), interpolated between the samples; a whole number of samples is exact.

    A delay of whole samples before the filter leaves no direct feedthrough and breaks algebraic loops; with linear interpolation
    these are delays of one sample and more. Before the first sample signals have the channels' initial values, or without these
    the value of the first sample. The filter acts on differences from the oldest sample, so that a constant signal stays the same
    to the last bit. With a `longest` delay [s] the block has the tunable parameter ``time``, from zero to that.

    Raises:
        InputError: the delay is too short for its interpolation.
    """
    channels = Channels(s, context, REFERENCE_KINDS)
    if s.known:
        channels.add(s.signal, context.before(s.signal), "reference.")
    if s.longest is not None:
        return _tunable(s.time, s.longest, channels)
    samples, rule = s.time / channels.h, s.interpolation
    whole = float(round(samples))
    samples = whole if abs(samples - whole) <= WHOLE * samples else samples
    design = thiran(rule.order, samples) if rule.kind == "thiran" else lagrange(rule.order, samples)
    n, depth, order = len(channels), design.depth, len(design.denominator)

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        memory = recall(x, repeated(channels.start(p, u), depth + order)) if depth else x
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
    return channels.block(
        f"Delay by {design.samples:.9g} samples",
        law,
        channels.starts if depth else (),
        memory=size,
        latency=design.samples * channels.h,
        symbol=casadi.MX if size >= VECTORISED_FROM else casadi.SX,
    )


def _tunable(time: float, longest: float, channels: Channels) -> SymbolicBlock:
    """The delay with linear interpolation as a parameter, which has the bits of the one with a fixed delay."""
    n, h = len(channels), channels.h
    depth = ceil(longest / h) + 1

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        initial, late = cut(p, p.numel() - 1, 1)
        signal = casadi.vertcat(u, recall(x, repeated(channels.start(initial, u), depth)))
        samples = late / h
        nearest = casadi.floor(samples + 0.5)
        samples = casadi.if_else(casadi.fabs(samples - nearest) <= WHOLE * samples, nearest, samples)
        whole = casadi.floor(samples)

        def past(place: Vector) -> Vector:
            columns: Vector = casadi.reshape(signal, n, depth + 1)
            return columns[:, place]

        newer, older = past(whole), past(whole + 1.0)
        between = older + (1.0 - (samples - whole)) * (newer - older)
        return casadi.if_else(samples == whole, newer, between), remember(*cut(signal, n * depth))

    parameter = Variable("time", "s", "Delay", "parameter", time, 0.0, longest, tunable=True)
    return channels.block(
        f"Delay of up to {longest:.9g} s",
        law,
        [*channels.starts, parameter],
        memory=n * depth,
        latency=time,
        symbol=casadi.MX,
    )
