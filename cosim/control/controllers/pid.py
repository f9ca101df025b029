"""PID control of the joints, from measured angles alone.

The continuous controller I' = K_i (q_r - q), T_f D' + D = K_d (c q_r - q)' is discretised exactly for signals that are
linear between the samples (triangle-hold equivalent: G. F. Franklin, J. D. Powell, M. L. Workman, Digital Control of
Dynamic Systems, 3rd ed. 1998, section 6.3.2). With e = q_r - q, d = c q_r - q, sample time h and a = exp(-h / T_f)::

    torque_k = sat(K_p (b q_r - q) + I_k + D_k + feedforward)
    I_k = I_k-1 + K_i h (e_k + e_k-1) / 2
    D_k = a D_k-1 + K_d (1 - a) (d_k - d_k-1) / h

Without a filter (T_f = 0, a = 0) D is the difference quotient. At the first sample the integral gets no increment and D
is zero, since there is no sample before. It begins at I_0 = initial torque + (1 - b) K_p q_r, so that the torque there is the initial
one for every b if the robot is at its reference: a bumpless start, section 3.6. Form, weights and anti-windup after K. J. Åström, T. Hägglund, Advanced PID
Control, ISA 2006, sections 3.3 to 3.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.controllers.anti_windup import AntiWindup, Clamping, from_section
from flexfmu.cosim.control.controllers.gain_schedule import with_schedule
from flexfmu.cosim.control.controllers.joints import (
    JOINTS,
    Limits,
    PerJoint,
    feedforwards,
    gains,
    measurements,
    per_joint,
    references,
    saturate,
    torque_limits,
    torques,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.controllers import FeedforwardSection, GravityFeedforwardSection, PidSection
from flexfmu.model.symbolic import SymbolicBlock

CLAMPING = Clamping()


@dataclass(frozen=True)
class PidLaw:
    """The PID law at the top of this module, for all joints at once.

    Attributes:
        joints: number of joints n.
        sample_time: h [s].
        setpoint_weight, derivative_weight: b and c.
        anti_windup: rule for the integral at the torque limits; None for no limits.
    """

    joints: int
    sample_time: float
    setpoint_weight: float
    derivative_weight: float
    anti_windup: AntiWindup | None

    def equations(self, x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return torques (n, 1) and next states: a flag, 1 after the first sample, and the last I, D, e and d."""
        n, h = self.joints, self.sample_time
        started, carried, slope, last_e, last_d = split(x, 1, n)
        q_r, q, feedforward = split(u, n)
        k_p, k_i, k_d, t_f, *bounds = split(p, n)
        e, d = q_r - q, self.derivative_weight * q_r - q
        # the weight acts on changes of the reference since the first sample: angles have any origin
        running = casadi.repmat(started, n, 1)
        if self.setpoint_weight != 1.0:
            carried = carried + casadi.if_else(running, 0.0, (1.0 - self.setpoint_weight) * k_p * q_r)
        # integral and filtered derivative; both stay as they are at the first sample
        increment = casadi.if_else(running, k_i * (h / 2.0) * (e + last_e), 0.0)
        fading = casadi.exp(-h / t_f)
        slope = casadi.if_else(running, fading * slope + k_d * ((1.0 - fading) / h) * (d - last_d), slope)
        rest = k_p * (self.setpoint_weight * q_r - q) + slope + feedforward
        # limits, with anti-windup
        if self.anti_windup is None:
            torque, carried = rest + carried + increment, carried + increment
        else:
            lower, upper = bounds
            now, carried = self.anti_windup.integrate(carried, increment, rest, lower, upper, h)
            torque = saturate(rest + now, lower, upper)
        return torque, casadi.vertcat(1.0, carried, slope, e, d)


def pid(
    proportional: PerJoint,
    integral: PerJoint,
    derivative: PerJoint,
    *,
    sample_time: float,
    offset: float = 0.0,
    filter_time: PerJoint = 0.0,
    setpoint_weight: float = 1.0,
    derivative_weight: float = 1.0,
    limits: Limits | None = None,
    anti_windup: AntiWindup = CLAMPING,
    initial_torque: PerJoint = 0.0,
    joints: Sequence[str] = JOINTS,
    name: str = "pid",
) -> SymbolicBlock:
    """Build the block: PID control of each joint by the law at the top of this module, plus a feedforward.

    Inputs: ``joint1.reference.position``, ``joint1.position``, ``joint1.feedforward`` (zero unless connected); output
    ``joint1.torque``. Gains, filter times and limits are tunable parameters ``joint1.proportional_gain``,
    ``.integral_gain``, ``.derivative_gain``, ``.filter_time``, ``.torque.minimum``, ``.torque.maximum``.

    Args:
        proportional: K_p [N.m/rad].
        integral: K_i [N.m/(rad.s)].
        derivative: K_d [N.m.s/rad].
        sample_time: time between samples [s].
        offset: first sample instant [s].
        filter_time: T_f [s] of the derivative.
        setpoint_weight: b; below 1 it reduces the overshoot after a step of the reference. It counts from the first sample on.
        derivative_weight: c; with 0 only the measurement is differentiated.
        limits: torque limits; None for none.
        anti_windup: rule for the integral at the limits.
        initial_torque: torque at the first sample [N.m], without what an error there and the feedforward add: with that which
            holds the robot nothing moves.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: a gain or time is negative or not finite, their number doesn't fit, or the sample time isn't
            positive.
    """
    # weights are constants, not parameters, so they are checked here
    for what, weight in (("setpoint", setpoint_weight), ("derivative", derivative_weight)):
        if not isfinite(weight):
            raise InputError(f"{name}: the {what} weight must be finite, usually 0 to 1, got {weight}")
    n = len(joints)
    law = PidLaw(n, sample_time, setpoint_weight, derivative_weight, anti_windup if limits else None)
    # start states: no sample yet, I at its initial torque, D, e and d zero
    return block(
        name,
        "PID control of the joints",
        law.equations,
        sample_time=sample_time,
        offset=offset,
        inputs=[*references(joints, "position"), *measurements(joints, "position"), *feedforwards(joints)],
        outputs=torques(joints),
        parameters=[
            *gains(joints, "proportional_gain", proportional, "N.m/rad", "Proportional gain"),
            *gains(joints, "integral_gain", integral, "N.m/rad/s", "Integral gain"),
            *gains(joints, "derivative_gain", derivative, "N.m.s/rad", "Derivative gain"),
            *gains(joints, "filter_time", filter_time, "s", "Time constant of the derivative filter"),
            *(limits.parameters(joints) if limits else ()),
        ],
        states=[0.0, *per_joint(joints, "initial_torque", initial_torque, "N.m"), *[0.0] * (3 * n)],
    )


GAINS = {
    "proportional": "proportional_gain",
    "integral": "integral_gain",
    "derivative": "derivative_gain",
}
"""Key of a schedule → gain."""


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
def _from_section(section: PidSection, context: LoopContext) -> SymbolicBlock:
    controller = pid(
        section.proportional,
        section.integral,
        section.derivative,
        filter_time=section.filter_time,
        setpoint_weight=section.setpoint_weight,
        derivative_weight=section.derivative_weight,
        limits=torque_limits(section.torque_limit),
        anti_windup=from_section(section.anti_windup),
        initial_torque=_initial_torque(section, context),
        sample_time=section.sample_time,
        offset=section.offset,
    )
    return with_schedule(controller, section.schedule, GAINS, context)
