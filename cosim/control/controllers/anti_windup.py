"""Anti-windup: rules for the integral of a controller whose output is saturated.

K. J. Åström, T. Hägglund, Advanced PID Control, ISA 2006, section 3.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, isfinite

import casadi

from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.controllers.joints import saturate
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene import controllers as scene


@dataclass(frozen=True)
class Clamping:
    """Conditional integration: leaves out an increment that would drive the output further into saturation."""


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


@dataclass(frozen=True)
class Unprotected:
    """No anti-windup: integrates whether or not the output is saturated."""


AntiWindup = Clamping | BackCalculation | Unprotected


def limited_sum(
    rest: Vector, integral: Vector, increment: Vector, bounds: Sequence[Vector], rule: AntiWindup, sample_time: float
) -> tuple[Vector, Vector]:
    """Return the limited sum of all terms of a controller, and the integral that the next sample starts from [N.m].

    Args:
        rest: all terms but the integral [N.m].
        integral: from the last sample [N.m].
        increment: of this sample [N.m].
        bounds: lower and upper torque limits [N.m]; empty for none.
        rule: what the integral does at the limits.
        sample_time: h [s].
    """
    if not bounds:
        return rest + integral + increment, integral + increment
    lower, upper = bounds
    if isinstance(rule, Clamping):
        # leave the increment out where the sum is beyond a limit and the increment drives it further
        candidate = rest + integral + increment
        above = casadi.logic_and(candidate > upper, increment > 0.0)
        below = casadi.logic_and(candidate < lower, increment < 0.0)
        increment = casadi.if_else(casadi.logic_or(above, below), 0.0, increment)
    now = integral + increment
    total = rest + now
    torque = saturate(total, lower, upper)
    if not isinstance(rule, BackCalculation):
        return torque, now
    # the next sample starts from the corrected integral
    share = 1.0 - exp(-sample_time / rule.tracking_time) if rule.tracking_time else 1.0
    return torque, now + share * (torque - total)


def rule_of(section: scene.AntiWindupSection) -> AntiWindup:
    """Return the rule of a section of the scene file."""
    if isinstance(section, scene.BackCalculationSection):
        return BackCalculation(section.tracking_time)
    return Clamping() if isinstance(section, scene.ClampingSection) else Unprotected()
