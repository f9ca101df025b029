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

Arguments that all loops share: `joints`.
"""

from __future__ import annotations

from typing import Unpack

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, split
from flexfmu.cosim.control.controllers.gain_schedule import with_schedule
from flexfmu.cosim.control.controllers.joints import (
    JOINTS,
    SIGNALS,
    TORQUE,
    JointOptions,
    PerJoint,
    TorqueLimits,
    joint_block,
    limited,
    per_joint,
)
from flexfmu.cosim.control.controllers.pid import CLAMPING, AntiWindup, limited_sum, rule_of
from flexfmu.cosim.control.imperfections.lag import lag_latency
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.slave import check_sampling
from flexfmu.model.scene.controllers import CascadeSection
from flexfmu.model.symbolic import SymbolicBlock, Variable

VELOCITY_COMMAND, TORQUE_COMMAND = ((each, SIGNALS[each][1] + " {}") for each in ("command.velocity", "command.torque"))
"""Outputs of an outer loop for the one inside, ``joint1.command.velocity`` and so on."""


def position_loop(
    proportional: PerJoint,
    *,
    velocity_feedforward: PerJoint = 1.0,
    velocity_limit: PerJoint | None = None,
    **options: Unpack[JointOptions],
) -> SymbolicBlock:
    """Build the outermost loop: velocity command = sat(K_v (q_r - q) + V w_r), without states.

    While a velocity is constant, and the loops inside have an integral, the angle lags behind by (1 - V) w_r / K_v.

    Inputs: ``joint1.reference.position``, ``.velocity``, ``joint1.position``; output ``joint1.command.velocity``. Gains and limits are
    ``joint1.position_gain``, ``.velocity_feedforward``, ``.velocity_limit``.

    Args:
        proportional: K_v [1/s].
        velocity_feedforward: V, the share of the reference velocity in the command.
        velocity_limit: largest magnitude of the command [rad/s]; None for none.
        options: ``sample_time`` [s], ``offset`` [s], ``joints``, ``name``.

    Raises:
        InputError: see `joints`.
    """

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        q_r, w_r, q = signals
        k_v, share, *limit = gains
        return limited(k_v * (q_r - q) + share * w_r, [sign * each for each in limit for sign in (-1.0, 1.0)]), x

    gains = {
        "position_gain": (proportional, "1/s", "Gain of the position loop"),
        "velocity_feedforward": (velocity_feedforward, "1", "Share of the reference velocity"),
    }
    if velocity_limit is not None:
        gains["velocity_limit"] = velocity_limit, "rad/s", "Largest magnitude of the velocity command"
    takes = "reference.position", "reference.velocity", "position"
    return joint_block("position", "Position loop of a drive", law, takes, VELOCITY_COMMAND, gains, **options)


def velocity_loop(
    proportional: PerJoint,
    integral: PerJoint,
    *,
    inertia: PerJoint = 0.0,
    limits: TorqueLimits = None,
    anti_windup: AntiWindup = CLAMPING,
    initial_torque: PerJoint = 0.0,
    commands_current: bool = True,
    **options: Unpack[JointOptions],
) -> SymbolicBlock:
    """Build the middle loop: torque command = sat(K_p e + I + J a_r + feedforward), e = velocity command - velocity.

    Inputs: ``joint1.command.velocity``, ``joint1.velocity``, ``joint1.reference.acceleration``, ``joint1.feedforward``; output
    ``joint1.command.torque``, or ``joint1.torque`` without a current loop. Gains are ``joint1.proportional_gain``, ``.integral_gain``,
    ``.inertia``.

    Args:
        proportional: K_p [N.m.s/rad].
        integral: K_i [N.m/rad]; K_p / K_i is the integral time.
        inertia: J [kg.m2], of the torque feedforward from the reference acceleration.
        limits: torque limits.
        anti_windup: rule for the integral at the limits.
        initial_torque: I at the start [N.m], for a bumpless start.
        commands_current: whether a current loop follows.
        options: ``sample_time`` [s], ``offset`` [s], ``joints``, ``name``.

    Raises:
        InputError: see `joints`.
    """
    joints, h = options.get("joints", JOINTS), options["sample_time"]
    n = len(joints)

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
        torque, carried = limited_sum(rest, carried, increment, bounds, anti_windup, h)
        return torque, casadi.vertcat(1.0, carried, e)

    return joint_block(
        "velocity",
        "Velocity loop of a drive",
        law,
        ("command.velocity", "velocity", "reference.acceleration", "feedforward"),
        TORQUE_COMMAND if commands_current else TORQUE,
        {
            "proportional_gain": (proportional, "N.m.s/rad", "Proportional gain of the velocity loop"),
            "integral_gain": (integral, "N.m/rad", "Integral gain of the velocity loop"),
            "inertia": (inertia, "kg.m2", "Inertia of the torque feedforward"),
        },
        limits=limits,
        states=[0.0, *per_joint(joints, "initial_torque", initial_torque, "N.m"), *[0.0] * n],
        **options,
    )


def current_loop(
    time_constant: PerJoint,
    *,
    limits: TorqueLimits = None,
    initial_torque: PerJoint = 0.0,
    **options: Unpack[JointOptions],
) -> SymbolicBlock:
    """Build the innermost loop: the torque follows its limited command as a lag, exact for commands that its samples hold.

    Input: ``joint1.command.torque``; output ``joint1.torque``, without direct feedthrough. Time constants (zero: a delay of one sample) and
    initial torques are parameters ``joint1.time_constant``, ``joint1.torque.initial``.

    Args:
        time_constant: T_e [s], 1 / (2 pi f) for a bandwidth f [Hz].
        limits: torque limits.
        initial_torque: torque before the first sample [N.m].
        options: ``sample_time`` [s], ``offset`` [s], ``joints``, ``name``.

    Raises:
        InputError: see `joints`.
    """
    joints, h = options.get("joints", JOINTS), options["sample_time"]
    check_sampling(h, options.get("offset", 0.0), options.get("name", "current"))
    n, times = len(joints), per_joint(joints, "time_constant", time_constant, "s", minimum=0.0)

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
        {"time_constant": (time_constant, "s", "Time constant of the current loop")},
        limits=limits,
        further=[
            Variable(f"{joint}.torque.initial", "N.m", f"Torque of {joint} before the first sample", "parameter", start)
            for joint, start in zip(joints, per_joint(joints, "initial_torque", initial_torque, "N.m"), strict=True)
        ],
        states=[0.0] * (1 + n),
        latency=[lag_latency(time, h) for time in times],
        **options,
    )


@builds(CascadeSection)
def _from_section(s: CascadeSection, context: LoopContext) -> tuple[SymbolicBlock, ...]:
    position, velocity, current = s.position, s.velocity, s.current
    outer = position_loop(
        position.proportional,
        velocity_feedforward=position.velocity_feedforward,
        velocity_limit=position.velocity_limit,
        **s.sampling_of(position),
    )
    inner = velocity_loop(
        velocity.proportional,
        velocity.integral,
        inertia=velocity.inertia,
        limits=s.torque_limit,
        anti_windup=rule_of(s.anti_windup),
        initial_torque=velocity.initial_torque,
        commands_current=current is not None,
        **s.sampling_of(velocity),
    )
    blocks = (
        with_schedule(outer, position.schedule, context, "position_gain"),
        with_schedule(inner, velocity.schedule, context),
    )
    if current is None:
        return blocks
    before = context.before("torque")
    lag = current_loop(current.time_constant, limits=s.torque_limit, initial_torque=before, **s.sampling_of(current))
    return (*blocks, lag)
