"""Filters of signals: notch, low-pass, high-pass, lead-lag and general ones, as chains of second-order sections.

A filter is designed in continuous time and made discrete by the bilinear transformation (Tustin), s → c (z - 1) / (z + 1) with
c = w / tan(w T / 2), which is exact at its frequency w (prewarping). At the first sample it is in the steady state of its input.

Source: A. V. Oppenheim and R. W. Schafer, *Discrete-Time Signal Processing*, Pearson 2010, sections 6.3 (transposed direct form II)
and 7.2 (bilinear transformation, Butterworth filters).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, isfinite, pi, tan

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, split
from flexfmu.cosim.control.imperfections.channels import REFERENCE_KINDS, Channels
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.linear import linear_plant
from flexfmu.model.scene import filters
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.statics import natural_frequencies
from flexfmu.model.symbolic import SymbolicBlock


@dataclass(frozen=True)
class SecondOrder:
    """A quotient of polynomials in s [rad/s] of order 2 at most, highest power first; exact at an angular frequency.

    Attributes:
        numerator, denominator: three coefficients each.
        prewarp: angular frequency [rad/s] at which the discrete section is exact; 0 for low frequencies.
    """

    numerator: tuple[float, float, float]
    denominator: tuple[float, float, float]
    prewarp: float = 0.0

    def discrete(self, sample_time: float) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """Coefficients (b0, b1, b2) and (a1, a2) of (b0 + b1 / z + b2 / z²) / (1 + a1 / z + a2 / z²).

        A section of lower order stays one: as a quotient of second order it would have a pole and a zero at z = -1, which
        cancel but for rounding.

        Raises:
            InputError: the frequency isn't below half the sampling frequency, or the section isn't finite, or not proper.
        """
        w, h = self.prewarp, sample_time
        order = next((2 - i for i, each in enumerate(self.denominator) if each), 0)
        if any(self.numerator[: 2 - order]):
            raise InputError(f"the filter {self} isn't proper: its numerator has the higher order")
        if w * h >= pi:
            raise InputError(
                f"a filter at {w / (2 * pi):g} Hz needs a sample time below {pi / w:.4g} s, got {h:g} s: lower the frequency, "
                f"or sample faster"
            )
        c = self.factor(h)
        top, bottom = (_in_z(each, c, order) for each in (self.numerator, self.denominator))
        found = [each / bottom[0] if bottom[0] else float("inf") for each in (*top, *bottom[1:])]
        if not all(map(isfinite, found)):
            raise InputError(f"the filter {self} has no discrete equivalent at {h:g} s")
        return (found[0], found[1], found[2]), (found[3], found[4])

    def factor(self, sample_time: float) -> float:
        """The factor c of the bilinear transformation [1/s]."""
        w, h = self.prewarp, sample_time
        return w / tan(0.5 * w * h) if w > 0.0 else 2.0 / h

    def __str__(self) -> str:
        """The quotient in s."""
        exact = f", exact at {self.prewarp / (2.0 * pi):.6g} Hz" if self.prewarp else ""
        return f"({_polynomial(self.numerator)})/({_polynomial(self.denominator)}){exact}"


def _in_z(polynomial: tuple[float, float, float], c: float, order: int) -> tuple[float, float, float]:
    """Coefficients in 1/z of a polynomial in s = c (z - 1)/(z + 1), times (z + 1) to its order."""
    p2, p1, p0 = polynomial
    if order == 2:
        return p2 * c * c + p1 * c + p0, 2.0 * (p0 - p2 * c * c), p2 * c * c - p1 * c + p0
    return (p1 * c + p0, p0 - p1 * c, 0.0) if order else (p0, 0.0, 0.0)


def _polynomial(coefficients: tuple[float, float, float]) -> str:
    """A polynomial in s as text."""
    terms = [f"{each:.6g}{power}" for each, power in zip(coefficients, (" s2", " s", ""), strict=True) if each]
    return " + ".join(terms) or "0"


def notch(frequency: float, damping: float = 0.5, depth: float = 0.0) -> list[SecondOrder]:
    """A notch at a frequency [Hz] whose gain there is ``depth``; ``damping`` is its width, relative to twice the frequency."""
    w = 2.0 * pi * frequency
    return [SecondOrder((1.0, 2.0 * depth * damping * w, w * w), (1.0, 2.0 * damping * w, w * w), w)]


def low_pass(frequency: float, order: int = 2) -> list[SecondOrder]:
    """A Butterworth low-pass with a gain of 1/√2 at a frequency [Hz]."""
    w = 2.0 * pi * frequency
    return [SecondOrder((0.0, 0.0, each[-1]) if each[0] else (0.0, 0.0, w), each, w) for each in _butterworth(w, order)]


def high_pass(frequency: float, order: int = 2) -> list[SecondOrder]:
    """A Butterworth high-pass with a gain of 1/√2 at a frequency [Hz]."""
    w = 2.0 * pi * frequency
    return [SecondOrder((1.0, 0.0, 0.0) if each[0] else (0.0, 1.0, 0.0), each, w) for each in _butterworth(w, order)]


def lead_lag(zero: float, pole: float) -> list[SecondOrder]:
    """(s / wz + 1) / (s / wp + 1) with a zero and a pole [Hz]; exact at the geometric mean of both, where it leads or lags most."""
    wz, wp = 2.0 * pi * zero, 2.0 * pi * pole
    return [SecondOrder((0.0, 1.0 / wz, 1.0), (0.0, 1.0 / wp, 1.0), float(np.sqrt(wz * wp)))]


def biquad(numerator: Sequence[float], denominator: Sequence[float], prewarp: float | None = None) -> list[SecondOrder]:
    """A quotient of polynomials in s [rad/s], highest power first, exact at ``prewarp`` [Hz]."""
    top, bottom = ((0.0, 0.0, 0.0, *each)[-3:] for each in (numerator, denominator))
    return [SecondOrder((top[0], top[1], top[2]), (bottom[0], bottom[1], bottom[2]), 2.0 * pi * (prewarp or 0.0))]


def _butterworth(w: float, order: int) -> list[tuple[float, float, float]]:
    """Denominators of the sections; an odd order has one of first order."""
    # angles of the poles from the negative real axis
    angles = [pi * (2 * k + 1 + order % 2) / (2 * order) for k in range(order // 2)]
    pairs = [2.0 * cos(each) for each in angles]
    found = [(1.0, w * each, w * w) for each in pairs]
    return [*found, (0.0, 1.0, w)] if order % 2 else found


def filter_block(s: filters.FilterSection, context: LoopContext, sections: Sequence[SecondOrder]) -> SymbolicBlock:
    """Build the block of a chain of second-order sections, one after the other, the same for each signal of a section of the scene file.

    Raises:
        InputError: a section's frequency isn't below half the sampling frequency.
    """
    channels = Channels(s, context, REFERENCE_KINDS)
    n, chain = len(channels), [each.discrete(channels.h) for each in sections]

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        started, *memory = split(x, 1, n)
        following = [casadi.SX.ones(1)]
        for k, (b, a) in enumerate(chain):
            # the steady state of the first input
            rest = _gain(b, a) * u
            first = casadi.if_else(started, memory[2 * k], rest - b[0] * u)
            second = casadi.if_else(started, memory[2 * k + 1], b[2] * u - a[1] * rest)
            y = b[0] * u + first
            following += [b[1] * u - a[0] * y + second, b[2] * u - a[1] * y]
            u = y
        return u, casadi.vertcat(*following)

    title = f"Filter {' · '.join(map(str, sections))}; s in rad/s, bilinear"
    return channels.block(title, equations, memory=2 * n * len(chain), latency=_delay(sections, channels.h))


def _gain(b: tuple[float, float, float], a: tuple[float, float]) -> float:
    """Gain at rest; 0 for a section that integrates."""
    below = 1.0 + sum(a)
    return sum(b) / below if abs(below) > 1e-12 else 0.0


def _delay(sections: Sequence[SecondOrder], sample_time: float) -> float:
    """Delay at low frequency [s], where there is one: there s stands for c sample_time / 2 times the frequency."""
    found = 0.0
    for each in sections:
        top, bottom = each.numerator, each.denominator
        if top[2] and bottom[2]:
            found += 0.5 * sample_time * each.factor(sample_time) * (bottom[1] / bottom[2] - top[1] / top[2])
    return max(0.0, found)


def frequency_of(section: filters.TunedSection, context: LoopContext) -> float:
    """The frequency of a section [Hz]: its own, or that of the mode that it names.

    Raises:
        InputError: the robot has no such mode.
    """
    if section.frequency is not None:
        return section.frequency
    match = filters.MODE.fullmatch(section.at or "")
    assert match is not None
    kind, number = match[1], int(match[2])
    found = _frequencies(kind, context, context.position(section.pose))
    if number > len(found):
        listed = ", ".join(f"{each:.4g}" for each in found) or "none"
        raise InputError(
            f"scene {context.scene.name} has no `{section.at}`: {kind}s at the {section.pose} in Hz: {listed}"
        )
    return float(found[number - 1])


def _frequencies(kind: str, context: LoopContext, position: tuple[float, float]) -> list[float]:
    """Frequencies [Hz] of the robot at a place of its end effector, with its motors locked or free, in ascending order."""
    if kind == "mode":
        first, second = motor_angles(context.scene.mechanism, position)
        return [float(each) for each in natural_frequencies(context.scene, (float(first), float(second)))]
    values = np.linalg.eigvals(linear_plant(context.scene, position, []).a)
    found = sorted(float(abs(each)) / (2.0 * pi) for each in values if each.imag > 0.0)
    # the two slowest motions are those of the motors against gravity
    elastic = len(values) // 2 - 2
    return found[len(found) - elastic :] if 0 < elastic <= len(found) else []


builds(filters.NotchSection)(lambda s, c: filter_block(s, c, notch(frequency_of(s, c), s.damping, s.depth)))
builds(filters.LowPassSection)(lambda s, c: filter_block(s, c, low_pass(frequency_of(s, c), s.order)))
builds(filters.HighPassSection)(lambda s, c: filter_block(s, c, high_pass(frequency_of(s, c), s.order)))
builds(filters.LeadLagSection)(lambda s, c: filter_block(s, c, lead_lag(s.zero, s.pole)))
builds(filters.BiquadSection)(lambda s, c: filter_block(s, c, biquad(s.numerator, s.denominator, s.prewarp)))
