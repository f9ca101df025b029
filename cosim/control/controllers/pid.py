"""PD control of the joints from measured angles and rates, and PID control from measured angles alone; shared arguments: `joints`.

The continuous PID controller I' = K_i (q_r - q), T_f D' + D = K_d (c q_r - q)' is discretised exactly for signals that are
linear between the samples (triangle-hold equivalent: G. F. Franklin, J. D. Powell, M. L. Workman, Digital Control of
Dynamic Systems, 3rd ed. 1998, section 6.3.2). With e = q_r - q, d = c q_r - q, sample time h and a = exp(-h / T_f)::

    torque_k = sat(K_p (b q_r - q) + I_k + D_k + feedforward)
    I_k = I_k-1 + K_i h (e_k + e_k-1) / 2
    D_k = a D_k-1 + K_d (1 - a) (d_k - d_k-1) / h

Without a filter (T_f = 0, a = 0) D is the difference quotient. At the first sample the integral gets no increment and D
is zero, since there is no sample before. It begins at I_0 = initial torque + (1 - b) K_p q_r, so that the torque there is the initial
one for every b if the robot is at its reference: a bumpless start, section 3.6. Form, weights and anti-windup, the rule for the integral at
the limits, after
K. J. Åström, T. Hägglund, Advanced PID Control, ISA 2006, sections 3.3 to 3.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, isfinite
from typing import Unpack

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, split
from flexfmu.cosim.control.controllers.gain_schedule import with_schedule
from flexfmu.cosim.control.controllers.joints import (
    JOINTS,
    TORQUE,
    JointOptions,
    PerJoint,
    TorqueLimits,
    joint_block,
    limited,
    per_joint,
    saturate,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene import controllers as scene
from flexfmu.model.scene.controllers import FeedforwardSection, GravityFeedforwardSection, PdSection, PidSection
from flexfmu.model.symbolic import SymbolicBlock


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


CLAMPING = Clamping()


def pd(
    proportional: PerJoint, derivative: PerJoint, *, limits: TorqueLimits = None, **options: Unpack[JointOptions]
) -> SymbolicBlock:
    """Build the block: torque = sat(K_p (q_r - q) + K_d (v_r - v) + feedforward) for each joint, without states.

    Inputs: ``joint1.reference.position``, ``.velocity``, ``joint1.position``, ``joint1.velocity``, ``joint1.feedforward``; output
    ``joint1.torque``. The gains are ``joint1.proportional_gain`` and ``joint1.derivative_gain``.

    Args:
        proportional: K_p [N.m/rad].
        derivative: K_d [N.m.s/rad].
        limits: torque limits.
        options: ``sample_time`` [s], ``offset`` [s], ``joints``, ``name``.

    Raises:
        InputError: see `joints`.
    """

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        q_r, v_r, q, v, feedforward = signals
        k_p, k_d, *bounds = gains
        return limited(k_p * (q_r - q) + k_d * (v_r - v) + feedforward, bounds), x

    return joint_block(
        "pd",
        "PD control of the joints",
        law,
        ("reference.position", "reference.velocity", "position", "velocity", "feedforward"),
        TORQUE,
        {
            "proportional_gain": (proportional, "N.m/rad", "Proportional gain"),
            "derivative_gain": (derivative, "N.m.s/rad", "Derivative gain"),
        },
        limits=limits,
        **options,
    )


@builds(PdSection)
def _pd_of_section(s: PdSection, context: LoopContext) -> SymbolicBlock:
    return with_schedule(pd(s.proportional, s.derivative, limits=s.torque_limit, **s.sampling), s.schedule, context)


def pid(
    proportional: PerJoint,
    integral: PerJoint,
    derivative: PerJoint,
    *,
    filter_time: PerJoint = 0.0,
    setpoint_weight: float = 1.0,
    derivative_weight: float = 1.0,
    limits: TorqueLimits = None,
    anti_windup: AntiWindup = CLAMPING,
    initial_torque: PerJoint = 0.0,
    **options: Unpack[JointOptions],
) -> SymbolicBlock:
    """Build the block: PID control of each joint by the law at the top of this module, plus a feedforward.

    Inputs: ``joint1.reference.position``, ``joint1.position``, ``joint1.feedforward``; output ``joint1.torque``. Gains and filter times
    are ``joint1.proportional_gain``, ``.integral_gain``, ``.derivative_gain``, ``.filter_time``.

    Args:
        proportional: K_p [N.m/rad].
        integral: K_i [N.m/(rad.s)].
        derivative: K_d [N.m.s/rad].
        filter_time: T_f [s] of the derivative.
        setpoint_weight: b; below 1 it reduces the overshoot after a step of the reference. It counts from the first sample on.
        derivative_weight: c; with 0 only the measurement is differentiated.
        limits: torque limits.
        anti_windup: rule for the integral at the limits.
        initial_torque: torque at the first sample [N.m], without what an error there and the feedforward add: with that which
            holds the robot nothing moves.
        options: ``sample_time`` [s], ``offset`` [s], ``joints``, ``name``.

    Raises:
        InputError: a weight isn't finite, or see `joints`.
    """
    # weights are constants, not parameters, so they are checked here
    for what, weight in (("setpoint", setpoint_weight), ("derivative", derivative_weight)):
        if not isfinite(weight):
            name = options.get("name", "pid")
            raise InputError(f"{name}: the {what} weight must be finite, usually 0 to 1, got {weight}")
    joints, h, b, c = options.get("joints", JOINTS), options["sample_time"], setpoint_weight, derivative_weight
    n = len(joints)

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        # states: a flag, 1 after the first sample, and the last I, D, e and d
        started, carried, slope, last_e, last_d = split(x, 1, n)
        q_r, q, feedforward = signals
        k_p, k_i, k_d, t_f, *bounds = gains
        e, d = q_r - q, c * q_r - q
        # the weight acts on changes of the reference since the first sample: angles have any origin
        running = casadi.repmat(started, n, 1)
        if b != 1.0:
            carried = carried + casadi.if_else(running, 0.0, (1.0 - b) * k_p * q_r)
        # integral and filtered derivative; both stay as they are at the first sample
        increment = casadi.if_else(running, k_i * (h / 2.0) * (e + last_e), 0.0)
        fading = casadi.exp(-h / t_f)
        slope = casadi.if_else(running, fading * slope + k_d * ((1.0 - fading) / h) * (d - last_d), slope)
        torque, carried = limited_sum(
            k_p * (b * q_r - q) + slope + feedforward, carried, increment, bounds, anti_windup, h
        )
        return torque, casadi.vertcat(1.0, carried, slope, e, d)

    return joint_block(
        "pid",
        "PID control of the joints",
        law,
        ("reference.position", "position", "feedforward"),
        TORQUE,
        {
            "proportional_gain": (proportional, "N.m/rad", "Proportional gain"),
            "integral_gain": (integral, "N.m/rad/s", "Integral gain"),
            "derivative_gain": (derivative, "N.m.s/rad", "Derivative gain"),
            "filter_time": (filter_time, "s", "Time constant of the derivative filter"),
        },
        limits=limits,
        states=[0.0, *per_joint(joints, "initial_torque", initial_torque, "N.m"), *[0.0] * (3 * n)],
        **options,
    )


def _initial_torque(section: PidSection, context: LoopContext) -> Sequence[float]:
    """Torque [N.m] of a section at the first sample: where it has none, what holds the robot and no feedforward adds."""
    if section.initial_torque is not None:
        return section.initial_torque
    is_held = any(
        isinstance(each, (FeedforwardSection, GravityFeedforwardSection)) for each in context.scene.controller
    )
    if is_held or context.is_about_rest or not any(section.integral):
        return (0.0, 0.0)
    # without an integral it would stay for ever
    holding = context.before("torque")
    return [torque if gain else 0.0 for torque, gain in zip(holding, section.integral, strict=False)] or (0.0, 0.0)


@builds(PidSection)
def _pid_of_section(s: PidSection, context: LoopContext) -> SymbolicBlock:
    controller = pid(
        s.proportional,
        s.integral,
        s.derivative,
        filter_time=s.filter_time,
        setpoint_weight=s.setpoint_weight,
        derivative_weight=s.derivative_weight,
        limits=s.torque_limit,
        anti_windup=rule_of(s.anti_windup),
        initial_torque=_initial_torque(s, context),
        **s.sampling,
    )
    return with_schedule(controller, s.schedule, context)
