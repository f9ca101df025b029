"""Digital filters that delay a signal by a fraction of a sample.

T. I. Laakso, V. Välimäki, M. Karjalainen, U. K. Laine, Splitting the unit delay: tools for fractional delay filter
design, IEEE Signal Processing Magazine 13(1), 1996, pp. 30-60.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, floor, isfinite, prod
from typing import Protocol

from flexfmu.cosim.control.imperfections.variables import whole_number
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import check_sampling

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


class Interpolation(Protocol):
    """A rule that interpolates a signal between its samples."""

    def design(self, samples: float) -> DelayFilter:
        """Return the filter of a delay.

        Args:
            samples: delay in samples, zero or positive, not necessarily whole.

        Raises:
            InputError: the delay is too short.
        """


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


def delay_in_samples(time: float, sample_time: float, where: str) -> float:
    """Return a delay in samples, a whole number where it is one within `WHOLE`.

    Args:
        time, sample_time: [s].
        where: name of the block, for messages.

    Raises:
        InputError: the delay is negative or not finite, or the sample time isn't positive.
    """
    check_sampling(sample_time, 0.0, where)
    if not (isfinite(time) and time >= 0.0):
        raise InputError(f"{where}: the delay must be zero or positive, got {time} s")
    samples = time / sample_time
    return float(round(samples)) if abs(samples - round(samples)) <= WHOLE * samples else samples


def _check_shortest(samples: float, shortest: float, what: str) -> None:
    if not samples >= shortest:
        raise InputError(
            f"a delay of {samples:g} samples is too short for {what}, which needs at least {shortest:g}; "
            "take a lower order, linear interpolation or a shorter sample time"
        )


LINEAR = Lagrange(1)
"""Linear interpolation."""
