"""Anti-windup: rules for the integral of a controller whose output is saturated.

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
from flexfmu.model.scene import controllers as scene


class AntiWindup(Protocol):
    """A rule for the integral of a saturated controller."""

    def integrate(
        self, integral: Vector, increment: Vector, rest: Vector, lower: Vector, upper: Vector, sample_time: float
    ) -> tuple[Vector, Vector]:
        """Return the integral for this sample's output, and the integral that the next sample starts from [N.m].

        Args:
            integral: from the last sample [N.m].
            increment: of this sample [N.m].
            rest: all other terms of the controller [N.m].
            lower: lower torque limits [N.m].
            upper: upper torque limits [N.m].
            sample_time: h [s].
        """


@dataclass(frozen=True)
class Clamping:
    """Conditional integration: leaves out an increment that would drive the output further into saturation."""

    def integrate(
        self, integral: Vector, increment: Vector, rest: Vector, lower: Vector, upper: Vector, sample_time: float
    ) -> tuple[Vector, Vector]:
        """Add the increment, unless the sum of all terms is beyond a limit and the increment drives it further."""
        candidate = rest + integral + increment
        above = casadi.logic_and(candidate > upper, increment > 0.0)
        below = casadi.logic_and(candidate < lower, increment < 0.0)
        result = integral + casadi.if_else(casadi.logic_or(above, below), 0.0, increment)
        return result, result


@dataclass(frozen=True)
class BackCalculation:
    """Back-calculation: I' = K_i e + (sat(v) - v) / T_t, where v is the sum of all terms.

    The second term is integrated exactly over a sample during which the other terms are constant: the excess
    v - sat(v) shrinks by the factor exp(-h / T_t). With T_t = 0 it vanishes within one sample.

    Attributes:
        tracking_time: T_t [s], zero or positive; between derivative and integral time, usually sqrt(T_i T_d).

    Raises:
        InputError: the tracking time is negative or not finite.
    """

    tracking_time: float

    def __post_init__(self) -> None:
        if not (isfinite(self.tracking_time) and self.tracking_time >= 0.0):
            raise InputError(f"the tracking time must be zero or positive, got {self.tracking_time} s")

    def integrate(
        self, integral: Vector, increment: Vector, rest: Vector, lower: Vector, upper: Vector, sample_time: float
    ) -> tuple[Vector, Vector]:
        """Add the full increment; the next sample starts from the corrected integral."""
        share = 1.0 - exp(-sample_time / self.tracking_time) if self.tracking_time else 1.0
        now = integral + increment
        total = rest + now
        return now, now + share * (saturate(total, lower, upper) - total)


@dataclass(frozen=True)
class Unprotected:
    """No anti-windup: integrates whether or not the output is saturated."""

    def integrate(
        self, integral: Vector, increment: Vector, rest: Vector, lower: Vector, upper: Vector, sample_time: float
    ) -> tuple[Vector, Vector]:
        """Add the full increment."""
        return integral + increment, integral + increment


def from_section(section: scene.AntiWindupSection) -> AntiWindup:
    """Return the rule of a section of the scene file."""
    match section:
        case scene.BackCalculationSection(tracking_time=time):
            return BackCalculation(time)
        case scene.ClampingSection():
            return Clamping()
        case scene.UnprotectedSection():
            return Unprotected()
