"""PD control of the joints from measured angles and rates, and PID control from measured angles alone.

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
from math import exp

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, split
from flexfmu.cosim.control.controllers.gain_schedule import with_schedule
from flexfmu.cosim.control.controllers.joints import JOINTS, TORQUE, joint_block, limited, saturate
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.model.scene import controllers
from flexfmu.model.symbolic import SymbolicBlock


def limited_sum(
    rest: Vector,
    integral: Vector,
    increment: Vector,
    bounds: Sequence[Vector],
    rule: controllers.AntiWindupSection,
    sample_time: float,
) -> tuple[Vector, Vector]:
    """Return the limited sum of all terms of a controller, and the integral that the next sample starts from [N.m].

    Back-calculation is I' = K_i e + (sat(v) - v) / T_t, where v is the sum of all terms. The second term is integrated exactly over
    a sample during which the other terms are constant: the excess v - sat(v) shrinks by the factor exp(-h / T_t). With T_t = 0 it
    vanishes within one sample.

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
    if isinstance(rule, controllers.ClampingSection):
        # leave the increment out where the sum is beyond a limit and the increment drives it further
        candidate = rest + integral + increment
        above = casadi.logic_and(candidate > upper, increment > 0.0)
        below = casadi.logic_and(candidate < lower, increment < 0.0)
        increment = casadi.if_else(casadi.logic_or(above, below), 0.0, increment)
    now = integral + increment
    total = rest + now
    torque = saturate(total, lower, upper)
    if not isinstance(rule, controllers.BackCalculationSection):
        return torque, now
    # the next sample starts from the corrected integral
    share = 1.0 - exp(-sample_time / rule.tracking_time) if rule.tracking_time else 1.0
    return torque, now + share * (torque - total)


@builds(controllers.PdSection)
def pd(s: controllers.PdSection, context: LoopContext) -> SymbolicBlock:
    """Build the block: torque = sat(K_p (q_r - q) + K_d (v_r - v) + feedforward) for each joint, without states.

    Inputs: ``joint1.reference.position``, ``.velocity``, ``joint1.position``, ``joint1.velocity``, ``joint1.feedforward``; output
    ``joint1.torque``. The gains are ``joint1.proportional_gain`` and ``joint1.derivative_gain``.
    """

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        q_r, v_r, q, v, feedforward = signals
        k_p, k_d, *bounds = gains
        return limited(k_p * (q_r - q) + k_d * (v_r - v) + feedforward, bounds), x

    controller = joint_block(
        "pd",
        "PD control of the joints",
        law,
        ("reference.position", "reference.velocity", "position", "velocity", "feedforward"),
        TORQUE,
        {
            "proportional_gain": (s.proportional, "N.m/rad", "Proportional gain"),
            "derivative_gain": (s.derivative, "N.m.s/rad", "Derivative gain"),
        },
        limit=s.torque_limit,
        **s.sampling,
    )
    return with_schedule(controller, s.schedule, context)


@builds(controllers.PidSection)
def pid(s: controllers.PidSection, context: LoopContext) -> SymbolicBlock:
    """Build the block: PID control of each joint by the law at the top of this module, plus a feedforward.

    Inputs: ``joint1.reference.position``, ``joint1.position``, ``joint1.feedforward``; output ``joint1.torque``. Gains and filter times
    are ``joint1.proportional_gain``, ``.integral_gain``, ``.derivative_gain``, ``.filter_time``.
    """
    h, b, c, n = s.sample_time, s.setpoint_weight, s.derivative_weight, len(JOINTS)

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
        rest = k_p * (b * q_r - q) + slope + feedforward
        torque, carried = limited_sum(rest, carried, increment, bounds, s.anti_windup, h)
        return torque, casadi.vertcat(1.0, carried, slope, e, d)

    controller = joint_block(
        "pid",
        "PID control of the joints",
        law,
        ("reference.position", "position", "feedforward"),
        TORQUE,
        {
            "proportional_gain": (s.proportional, "N.m/rad", "Proportional gain"),
            "integral_gain": (s.integral, "N.m/rad/s", "Integral gain"),
            "derivative_gain": (s.derivative, "N.m.s/rad", "Derivative gain"),
            "filter_time": (s.filter_time, "s", "Time constant of the derivative filter"),
        },
        limit=s.torque_limit,
        states=[0.0, *_initial_torque(s, context), *[0.0] * (3 * n)],
        **s.sampling,
    )
    return with_schedule(controller, s.schedule, context)


def _initial_torque(section: controllers.PidSection, context: LoopContext) -> Sequence[float]:
    """Torque [N.m] of a section at the first sample: where it has none, what holds the robot and no feedforward adds."""
    if section.initial_torque is not None:
        return section.initial_torque
    is_held = any(
        isinstance(each, (controllers.FeedforwardSection, controllers.GravityFeedforwardSection))
        for each in context.scene.controller
    )
    if is_held or context.is_about_rest or not any(section.integral):
        return (0.0, 0.0)
    # without an integral it would stay for ever
    holding = context.before("torque")
    return [torque if gain else 0.0 for torque, gain in zip(holding, section.integral, strict=False)] or (0.0, 0.0)
