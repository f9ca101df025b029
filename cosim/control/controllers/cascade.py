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

from collections.abc import Sequence
from dataclasses import dataclass
from math import expm1

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
from flexfmu.cosim.control.imperfections.channels import JOINT_UNITS
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.slave import check_sampling
from flexfmu.model.scene.controllers import CascadeSection
from flexfmu.model.symbolic import Causality, SymbolicBlock, Variable

CLAMPING = Clamping()


def commands(joints: Sequence[str], kind: str, causality: Causality) -> list[Variable]:
    """Return ``joint1.command.velocity`` or ``joint1.command.torque`` and so on, which an outer loop outputs for the one inside."""
    start = 0.0 if causality == "input" else None
    text = f"{kind.capitalize()} that the outer loop commands of"
    return [
        Variable(f"{each}.command.{kind}", JOINT_UNITS[kind], f"{text} {each}", causality, start) for each in joints
    ]


def position_loop(
    proportional: PerJoint,
    *,
    sample_time: float,
    offset: float = 0.0,
    velocity_feedforward: PerJoint = 1.0,
    velocity_limit: PerJoint | None = None,
    joints: Sequence[str] = JOINTS,
    name: str = "position",
) -> SymbolicBlock:
    """Build the outermost loop: velocity command = sat(K_v (q_r - q) + V w_r), without states.

    While a velocity is constant, and the loops inside have an integral, the angle lags behind by (1 - V) w_r / K_v.

    Inputs: ``joint1.reference.position``, ``.velocity``, ``joint1.position``; output ``joint1.command.velocity``. Gains and limits are
    tunable parameters ``joint1.position_gain``, ``.velocity_feedforward``, ``.velocity_limit``.

    Args:
        proportional: K_v [1/s].
        sample_time, offset: sample time and first sample instant [s].
        velocity_feedforward: V, the share of the reference velocity in the command.
        velocity_limit: largest magnitude of the command [rad/s]; None for none.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: a gain or limit is negative or not finite, their number doesn't fit, or the sample time isn't positive.
    """

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        q_r, w_r, q = split(u, len(joints))
        k_v, share, *limit = split(p, len(joints))
        command = k_v * (q_r - q) + share * w_r
        return saturate(command, -limit[0], limit[0]) if limit else command, x

    what = "Largest magnitude of the velocity command"
    limits = [] if velocity_limit is None else gains(joints, "velocity_limit", velocity_limit, "rad/s", what)
    return block(
        name,
        "Position loop of a drive",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=[*references(joints, "position", "velocity"), *measurements(joints, "position")],
        outputs=commands(joints, "velocity", "output"),
        parameters=[
            *gains(joints, "position_gain", proportional, "1/s", "Gain of the position loop"),
            *gains(joints, "velocity_feedforward", velocity_feedforward, "1", "Share of the reference velocity"),
            *limits,
        ],
    )


@dataclass(frozen=True)
class _VelocityLaw:
    """The PI law at the top of this module, for all joints at once.

    Attributes:
        joints: number of joints n.
        sample_time: h [s].
        anti_windup: rule for the integral at the torque limits; None for no limits.
    """

    joints: int
    sample_time: float
    anti_windup: AntiWindup | None

    def equations(self, x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        """Return torques (n, 1) and next states: a flag, 1 after the first sample, and the last I and e."""
        n, h = self.joints, self.sample_time
        started, carried, last_e = split(x, 1, n)
        command, velocity, acceleration, feedforward = split(u, n)
        k_p, k_i, inertia, *bounds = split(p, n)
        # the integral, which stays as it is at the first sample, and all the rest
        e = command - velocity
        increment = casadi.if_else(casadi.repmat(started, n, 1), k_i * (h / 2.0) * (e + last_e), 0.0)
        rest = k_p * e + inertia * acceleration + feedforward
        # limits, with anti-windup
        if self.anti_windup is None:
            carried = carried + increment
            torque = rest + carried
        else:
            now, carried = self.anti_windup.integrate(carried, increment, rest, bounds[0], bounds[1], h)
            torque = saturate(rest + now, bounds[0], bounds[1])
        return torque, casadi.vertcat(1.0, carried, e)


def velocity_loop(
    proportional: PerJoint,
    integral: PerJoint,
    *,
    sample_time: float,
    offset: float = 0.0,
    inertia: PerJoint = 0.0,
    limits: Limits | None = None,
    anti_windup: AntiWindup = CLAMPING,
    initial_torque: PerJoint = 0.0,
    commands_current: bool = True,
    joints: Sequence[str] = JOINTS,
    name: str = "velocity",
) -> SymbolicBlock:
    """Build the middle loop: torque command = sat(K_p e + I + J a_r + feedforward), e = velocity command - velocity.

    Inputs: ``joint1.command.velocity``, ``joint1.velocity``, ``joint1.reference.acceleration``, ``joint1.feedforward`` (zero unless
    connected); output ``joint1.command.torque``, or ``joint1.torque`` without a current loop. Gains and limits are tunable parameters
    ``joint1.proportional_gain``, ``.integral_gain``, ``.inertia``, ``.torque.minimum``, ``.torque.maximum``.

    Args:
        proportional: K_p [N.m.s/rad].
        integral: K_i [N.m/rad]; K_p / K_i is the integral time.
        sample_time, offset: sample time and first sample instant [s].
        inertia: J [kg.m2], of the torque feedforward from the reference acceleration.
        limits: torque limits; None for none.
        anti_windup: rule for the integral at the limits.
        initial_torque: I at the start [N.m], for a bumpless start.
        commands_current: whether a current loop follows.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: a gain is negative or not finite, their number doesn't fit, or the sample time isn't positive.
    """
    n = len(joints)
    law = _VelocityLaw(n, sample_time, anti_windup if limits else None)
    # start states: no sample yet, I at its initial torque, e zero
    return block(
        name,
        "Velocity loop of a drive",
        law.equations,
        sample_time=sample_time,
        offset=offset,
        inputs=[
            *commands(joints, "velocity", "input"),
            *measurements(joints, "velocity"),
            *references(joints, "acceleration"),
            *feedforwards(joints),
        ],
        outputs=commands(joints, "torque", "output") if commands_current else torques(joints),
        parameters=[
            *gains(joints, "proportional_gain", proportional, "N.m.s/rad", "Proportional gain of the velocity loop"),
            *gains(joints, "integral_gain", integral, "N.m/rad", "Integral gain of the velocity loop"),
            *gains(joints, "inertia", inertia, "kg.m2", "Inertia of the torque feedforward"),
            *(limits.parameters(joints) if limits else ()),
        ],
        states=[0.0, *per_joint(joints, "initial_torque", initial_torque, "N.m"), *[0.0] * n],
    )


def current_loop(
    time_constant: PerJoint,
    *,
    sample_time: float,
    offset: float = 0.0,
    limits: Limits | None = None,
    initial_torque: PerJoint = 0.0,
    joints: Sequence[str] = JOINTS,
    name: str = "current",
) -> SymbolicBlock:
    """Build the innermost loop: the torque follows its limited command as a lag, exact for commands that its samples hold.

    Input: ``joint1.command.torque``; output ``joint1.torque``, without direct feedthrough. Time constants (zero: a delay of one sample),
    limits and initial torques are parameters ``joint1.time_constant``, ``joint1.torque.minimum``, ``.maximum``, ``.initial``.

    Args:
        time_constant: T_e [s], 1 / (2 pi f) for a bandwidth f [Hz].
        sample_time, offset: sample time and first sample instant [s].
        limits: torque limits; None for none.
        initial_torque: torque before the first sample [N.m].
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: a time constant is negative or not finite, their number doesn't fit, or the sample time isn't positive.
    """
    check_sampling(sample_time, offset, name)
    n, h = len(joints), sample_time
    times = gains(joints, "time_constant", time_constant, "s", "Time constant of the current loop")
    starts = per_joint(joints, "initial_torque", initial_torque, "N.m")

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        started, last = split(x, 1, n)
        time, *bounds, initial = split(p, n)
        torque = casadi.if_else(casadi.repmat(started, n, 1), last, initial)
        target = saturate(u, *bounds) if limits else u
        return torque, casadi.vertcat(1.0, target + casadi.exp(-h / time) * (torque - target))

    return block(
        name,
        "Current loop of a drive",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=commands(joints, "torque", "input"),
        outputs=torques(joints),
        parameters=[
            *times,
            *(limits.parameters(joints) if limits else ()),
            *(
                Variable(
                    f"{joint}.torque.initial", "N.m", f"Torque of {joint} before the first sample", "parameter", start
                )
                for joint, start in zip(joints, starts, strict=True)
            ),
        ],
        states=[0.0] * (1 + n),
        # mean delay of the impulse response
        latency={
            f"{joint}.torque": h / -expm1(-h / time.start) if time.start else h
            for joint, time in zip(joints, times, strict=True)
        },
    )


POSITION_GAINS = {"proportional": "position_gain", "velocity_feedforward": "velocity_feedforward"}
VELOCITY_GAINS = {"proportional": "proportional_gain", "integral": "integral_gain", "inertia": "inertia"}
"""Key of a schedule → gain."""


@builds(CascadeSection)
def _from_section(section: CascadeSection, context: LoopContext) -> tuple[SymbolicBlock, ...]:
    position, velocity, current = section.position, section.velocity, section.current
    limits = torque_limits(section.torque_limit)
    outer = position_loop(
        position.proportional,
        velocity_feedforward=position.velocity_feedforward,
        velocity_limit=position.velocity_limit,
        **section.sampling(position),
    )
    inner = velocity_loop(
        velocity.proportional,
        velocity.integral,
        inertia=velocity.inertia,
        limits=limits,
        anti_windup=from_section(section.anti_windup),
        initial_torque=velocity.initial_torque,
        commands_current=current is not None,
        **section.sampling(velocity),
    )
    blocks = [
        with_schedule(outer, position.schedule, POSITION_GAINS, context),
        with_schedule(inner, velocity.schedule, VELOCITY_GAINS, context),
    ]
    if current is not None:
        torque = context.before("torque")
        lag = current_loop(current.time_constant, limits=limits, initial_torque=torque, **section.sampling(current))
        blocks.append(lag)
    return tuple(blocks)
