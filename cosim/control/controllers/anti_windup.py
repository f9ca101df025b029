"""What an integrator does while the output is saturated.

K. J. Åström, T. Hägglund, Advanced PID Control, ISA 2006, section 3.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite
from typing import Protocol

import casadi

from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.controllers.joints import saturate
from flexfmu.cosim.engine.errors import InputError


class AntiWindup(Protocol):
    """A rule for the integral of a saturated controller."""

    def integrate(
        self, integral: Vector, increment: Vector, rest: Vector, lower: Vector, upper: Vector, sample_time: float
    ) -> tuple[Vector, Vector]:
        """Integral for this sample's output, and integral to start the next sample from.

        Args:
            integral: value carried over from the last sample [N.m].
            increment: what this sample adds [N.m].
            rest: all other terms of the controller [N.m].
            lower, upper: torque limits [N.m].
            sample_time: h [s].
        """


@dataclass(frozen=True)
class Clamping:
    """Conditional integration: no increment that would drive a saturated output further into saturation."""

    def integrate(
        self, integral: Vector, increment: Vector, rest: Vector, lower: Vector, upper: Vector, sample_time: float
    ) -> tuple[Vector, Vector]:
        """The increment, or nothing where it would add to the saturation."""
        candidate = rest + integral + increment
        above = casadi.logic_and(candidate > upper, increment > 0.0)
        below = casadi.logic_and(candidate < lower, increment < 0.0)
        result = integral + casadi.if_else(casadi.logic_or(above, below), 0.0, increment)
        return result, result


@dataclass(frozen=True)
class BackCalculation:
    """The integral follows I' = K_i e + (sat(v) - v) / T_t, v being the sum of all terms.

    Over one sample the second term is integrated exactly for held other terms: the excess v - sat(v) shrinks by the
    factor exp(-h / T_t). Zero takes it away within one sample.

    Attributes:
        tracking_time: T_t [s]; between derivative and integral time, sqrt(T_i T_d) is common.
    """

    tracking_time: float

    def __post_init__(self) -> None:
        if not (isfinite(self.tracking_time) and self.tracking_time >= 0.0):
            raise InputError(f"the tracking time must be zero or positive, got {self.tracking_time} s")

    def integrate(
        self, integral: Vector, increment: Vector, rest: Vector, lower: Vector, upper: Vector, sample_time: float
    ) -> tuple[Vector, Vector]:
        """The full increment now, the correction for the next sample."""
        share = 1.0 - exp(-sample_time / self.tracking_time) if self.tracking_time else 1.0
        now = integral + increment
        total = rest + now
        return now, now + share * (saturate(total, lower, upper) - total)


@dataclass(frozen=True)
class Unprotected:
    """The integral goes on whatever the output does, and winds up."""

    def integrate(
        self, integral: Vector, increment: Vector, rest: Vector, lower: Vector, upper: Vector, sample_time: float
    ) -> tuple[Vector, Vector]:
        """The full increment."""
        return integral + increment, integral + increment
