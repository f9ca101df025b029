"""The cascade of an industrial drive: a P loop of the position around a PI loop of the velocity around the current loop.

Each loop is a block with its own sample time and offset. With references r, measurements q, w of angle and velocity, sample time h of
the loop itself, and sat the limits::

    position    w_c,k = sat(K_v (q_r - q) + V w_r)                                                  velocity command
    velocity    T_c,k = sat(K_p e_k + I_k + J a_r + feedforward)      e = w_c - w                   torque command
                I_k = I_k-1 + K_i h (e_k + e_k-1) / 2
    current     T_k+1 = sat(T_c,k) + exp(-h / T_e) (T_k - sat(T_c,k))                               torque

Structure and tuning: H. Gross, J. Hamann, G. Wiegärtner, Electrical Feed Drives in Automation, 2001, chapters 4 and 5. The closed current
loop is a lag T_e y' + y = u, discretised exactly for commands that its own samples hold (zero-order-hold equivalent: G. F. Franklin,
J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd ed. 1998, section 4.3). I gets no increment at the first sample, since
there is none before (trapezoids, section 6.3.2).

Anti-windup: I is the only integral of the cascade. The velocity loop knows the limits of the current loop and stops I at them; the velocity
command is limited in a loop without an integral. So no limit winds up a loop outside it.
"""

from __future__ import annotations

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, split
from flexfmu.cosim.control.controllers.gain_schedule import with_schedule
from flexfmu.cosim.control.controllers.joints import JOINTS, SIGNALS, TORQUE, joint_block, limited
from flexfmu.cosim.control.controllers.pid import limited_sum
from flexfmu.cosim.control.imperfections.lag import lag_latency
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.model.scene.controllers import CascadeSection, CurrentLoopSection, PositionLoopSection
from flexfmu.model.scene.loop import Sampling
from flexfmu.model.symbolic import SymbolicBlock, Variable

VELOCITY_COMMAND, TORQUE_COMMAND = ((each, SIGNALS[each][1] + " {}") for each in ("command.velocity", "command.torque"))
"""Outputs of an outer loop for the one inside, ``joint1.command.velocity`` and so on."""


@builds(CascadeSection)
def cascade(s: CascadeSection, context: LoopContext) -> tuple[SymbolicBlock, ...]:
    """Build the blocks of the loops, the outermost first; without a current loop the torque is its command.

    A scheduled factor on ``proportional`` is one on the loop's own gain.
    """
    position = with_schedule(position_loop(s.position, s.sampling_of(s.position)), s.position.schedule, context, GAIN)
    velocity = with_schedule(velocity_loop(s), s.velocity.schedule, context)
    current = [] if s.current is None else [current_loop(s, s.current, context)]
    return position, velocity, *current


GAIN = "position_gain"
"""Gain of the position loop, a parameter of each joint."""


def position_loop(s: PositionLoopSection, timing: Sampling) -> SymbolicBlock:
    """Build the outermost loop: velocity command = sat(K_v (q_r - q) + V w_r), without states.

    While a velocity is constant, and the loops inside have an integral, the angle lags behind by (1 - V) w_r / K_v.

    Inputs: ``joint1.reference.position``, ``.velocity``, ``joint1.position``; output ``joint1.command.velocity``. Gains and limits are
    ``joint1.position_gain``, ``.velocity_feedforward``, ``.velocity_limit``.
    """

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        q_r, w_r, q = signals
        k_v, share, *limit = gains
        return limited(k_v * (q_r - q) + share * w_r, [sign * each for each in limit for sign in (-1.0, 1.0)]), x

    gains = {
        GAIN: (s.proportional, "1/s", "Gain of the position loop"),
        "velocity_feedforward": (s.velocity_feedforward, "1", "Share of the reference velocity"),
    }
    if s.velocity_limit is not None:
        gains["velocity_limit"] = s.velocity_limit, "rad/s", "Largest magnitude of the velocity command"
    takes = "reference.position", "reference.velocity", "position"
    return joint_block("position", "Position loop of a drive", law, takes, VELOCITY_COMMAND, gains, **timing)


def velocity_loop(s: CascadeSection) -> SymbolicBlock:
    """Build the middle loop: torque command = sat(K_p e + I + J a_r + feedforward), e = velocity command - velocity.

    Inputs: ``joint1.command.velocity``, ``joint1.velocity``, ``joint1.reference.acceleration``, ``joint1.feedforward``; output
    ``joint1.command.torque``, or ``joint1.torque`` without a current loop. Gains are ``joint1.proportional_gain``, ``.integral_gain``,
    ``.inertia``.
    """
    own, timing, n = s.velocity, s.sampling_of(s.velocity), len(JOINTS)
    h = timing["sample_time"]

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        # states: a flag, 1 after the first sample, and the last I and e
        started, carried, last_e = split(x, 1, n)
        command, velocity, acceleration, feedforward = signals
        k_p, k_i, inertia, *bounds = gains
        # the integral, which stays as it is at the first sample, and all the rest
        e = command - velocity
        increment = casadi.if_else(casadi.repmat(started, n, 1), k_i * (h / 2.0) * (e + last_e), 0.0)
        rest = k_p * e + inertia * acceleration + feedforward
        if not bounds:
            return rest + (carried + increment), casadi.vertcat(1.0, carried + increment, e)
        torque, carried = limited_sum(rest, carried, increment, bounds, s.anti_windup, h)
        return torque, casadi.vertcat(1.0, carried, e)

    return joint_block(
        "velocity",
        "Velocity loop of a drive",
        law,
        ("command.velocity", "velocity", "reference.acceleration", "feedforward"),
        TORQUE if s.current is None else TORQUE_COMMAND,
        {
            "proportional_gain": (own.proportional, "N.m.s/rad", "Proportional gain of the velocity loop"),
            "integral_gain": (own.integral, "N.m/rad", "Integral gain of the velocity loop"),
            "inertia": (own.inertia, "kg.m2", "Inertia of the torque feedforward"),
        },
        limit=s.torque_limit,
        states=[0.0, *own.initial_torque, *[0.0] * n],
        **timing,
    )


def current_loop(s: CascadeSection, own: CurrentLoopSection, context: LoopContext) -> SymbolicBlock:
    """Build the innermost loop: the torque follows its limited command as a lag, exact for commands that its samples hold.

    Input: ``joint1.command.torque``; output ``joint1.torque``, without direct feedthrough. Time constants (zero: a delay of one sample) and
    torques before the first sample are parameters ``joint1.time_constant``, ``joint1.torque.initial``.
    """
    timing, n = s.sampling_of(own), len(JOINTS)
    h = timing["sample_time"]

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        started, last = split(x, 1, n)
        time, *bounds, initial = gains
        torque, target = casadi.if_else(casadi.repmat(started, n, 1), last, initial), limited(signals[0], bounds)
        return torque, casadi.vertcat(1.0, target + casadi.exp(-h / time) * (torque - target))

    return joint_block(
        "current",
        "Current loop of a drive",
        law,
        ("command.torque",),
        TORQUE,
        {"time_constant": (own.time_constant, "s", "Time constant of the current loop")},
        limit=s.torque_limit,
        further=[
            Variable(f"{joint}.torque.initial", "N.m", f"Torque of {joint} before the first sample", "parameter", start)
            for joint, start in zip(JOINTS, context.before("torque"), strict=True)
        ],
        states=[0.0] * (1 + n),
        latency=[lag_latency(time, h) for time in own.time_constant],
        **timing,
    )
