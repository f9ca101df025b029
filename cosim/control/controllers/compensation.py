"""Feedforwards against friction and disturbances, added to the torque of another controller; shared arguments: `joints`.

The observer estimates the torque that the model lacks from the motion. At the instant k, with the torque T_k-1 that was held since the last
instant, sample time h, the mean velocity w between both instants and the mean angle q, and the model's torque ID for the measured
acceleration::

    f_k = a f_k-1 + (1 - a) (T_k-1 - ID(q, w, (w_k - w_k-1) / h))        a = exp(-h / T)

On a joint with the inertia that the model assumes, under a held torque and a constant disturbance d, the bracket is -d exactly, so that
f_k = -d (1 - a^k) whatever the torques are. K. Ohnishi, M. Shibata, T. Murakami, Motion control for advanced mechatronics, IEEE/ASME
Trans. Mechatronics 1 (1996) 56, with the difference quotient in place of the derivative. Friction: B. Armstrong-Hélouvry, P. Dupont,
C. Canudas de Wit, A survey of models, analysis tools and compensation methods for the control of machines with friction, Automatica 30
(1994), section 6.3.
"""

from __future__ import annotations

from typing import Unpack

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, split
from flexfmu.cosim.control.controllers.computed_torque import Motion, assumed_dynamics, check_dynamics, read
from flexfmu.cosim.control.controllers.joints import (
    JOINTS,
    Gains,
    JointOptions,
    PerJoint,
    TorqueLimits,
    joint_block,
    limited,
    per_joint,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.controllers import DisturbanceObserverSection, FrictionCompensationSection
from flexfmu.model.symbolic import SymbolicBlock


def friction_compensation(
    viscous: PerJoint,
    coulomb: PerJoint,
    *,
    velocity: float = 0.01,
    motion: Motion = "reference",
    **options: Unpack[JointOptions],
) -> SymbolicBlock:
    """Build the block: feedforward = viscous w + coulomb w / sqrt(w² + velocity²), with the motor rate w; without states.

    It is the law of the scene's smooth friction. A compensation from the measured velocity that is stronger than the friction feeds
    energy into the loop: keep it below.

    Input: ``joint1.reference.velocity`` or ``joint1.velocity``; output ``joint1.feedforward``. Coefficients are tunable parameters
    ``joint1.viscous_friction``, ``joint1.coulomb_friction``.

    Args:
        viscous: coefficient [N.m.s/rad].
        coulomb: dry friction [N.m].
        velocity: rate [rad/s] that smooths the change of sign; 71 % of the dry friction at this rate.
        motion: whether w is that of the reference or measured.
        options: ``sample_time`` [s], ``offset`` [s], ``joints``, ``name``.

    Raises:
        InputError: the smoothing velocity isn't positive, or see `joints`.
    """
    name = options.get("name", "friction_compensation")
    (smoothing,) = per_joint(("the motors",), "velocity", velocity, "rad/s")
    if smoothing <= 0.0:
        raise InputError(f"{name}: the smoothing velocity must be above 0 rad/s, got {velocity}; try 0.01")

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        (w,), (d, c) = signals, gains
        return d * w + c * w / casadi.sqrt(w**2 + smoothing**2), x

    return joint_block(
        "friction_compensation",
        "Compensation of the motors' friction",
        law,
        [read("velocity", motion, name)],
        ("feedforward", "Torque against the friction of {}"),
        {
            "viscous_friction": (viscous, "N.m.s/rad", "Viscous friction that is compensated"),
            "coulomb_friction": (coulomb, "N.m", "Dry friction that is compensated"),
        },
        **options,
    )


@builds(FrictionCompensationSection)
def _friction_of_section(s: FrictionCompensationSection, context: LoopContext) -> SymbolicBlock:
    # the scene's own friction, unless the section has its own
    friction = context.scene.effects.joint_friction
    viscous = friction.viscous if s.viscous is None else s.viscous
    coulomb = friction.coulomb if s.coulomb is None else s.coulomb
    smoothing = getattr(friction, "velocity", 0.01) if s.velocity is None else s.velocity
    if s.viscous is None and s.coulomb is None and not friction.is_there:
        raise InputError(
            f"{context.name} has no friction to compensate: give it `viscous` [N.m.s/rad] or `coulomb` [N.m], or the robot "
            "`effects.joint_friction`"
        )
    return friction_compensation(viscous, coulomb, velocity=smoothing, motion=s.motion, **s.sampling)


def disturbance_observer(
    model: casadi.Function | PerJoint,
    time_constant: PerJoint,
    *,
    limits: TorqueLimits = None,
    **options: Unpack[JointOptions],
) -> SymbolicBlock:
    """Build the block of the observer at the top of this module; its output has no direct feedthrough of the torque.

    It must sample at the instants at which the torque changes: a torque that changes in between isn't the one that it reads.

    Inputs: ``joint1.position`` (with inverse dynamics), ``joint1.velocity``, ``joint1.torque``; output ``joint1.feedforward``, zero at the
    first sample. Inertias and time constants are tunable parameters ``joint1.inertia``, ``.time_constant``.

    Args:
        model: inverse dynamics (q, v, a) → torque [rad, rad/s, rad/s2 → N.m] of the robot without the disturbance, or the inertia of each
            joint [kg.m2], of which then gravity and all other joints are disturbances.
        time_constant: T [s], zero or positive: 1 / (2 pi f) for a bandwidth f [Hz].
        limits: limits of the feedforward.
        options: ``sample_time`` [s], ``offset`` [s], ``joints``, ``name``.

    Raises:
        InputError: the inverse dynamics don't fit the joints, or see `joints`.
    """
    n, h = len(options.get("joints", JOINTS)), options["sample_time"]
    dynamics: casadi.Function | None = None
    kinds: tuple[str, ...] = ("velocity",)
    gains: Gains = {"time_constant": (time_constant, "s", "Time constant of the observer")}
    if isinstance(model, casadi.Function):
        check_dynamics(model, "disturbance_observer", options)
        dynamics, kinds = model, ("position", "velocity")
    else:
        gains = {**gains, "inertia": (model, "kg.m2", "Inertia that the observer assumes")}

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        started, feedforward, last_torque, *last = split(x, 1, n)
        *now, torque = signals
        time, *rest = gains
        # the torque of the model for the motion since the last instant
        means = [0.5 * (each + before) for each, before in zip(now, last, strict=True)]
        acceleration = (now[-1] - last[-1]) / h
        known = rest.pop(0) * acceleration if dynamics is None else dynamics.call([*means, acceleration])[0]
        # the filtered difference; nothing is known at the first sample
        a = casadi.exp(-h / time)
        estimate = a * feedforward + (1.0 - a) * (last_torque - known)
        feedforward = casadi.if_else(casadi.repmat(started, n, 1), estimate, 0.0)
        return limited(feedforward, rest), casadi.vertcat(1.0, feedforward, torque, *now)

    return joint_block(
        "disturbance_observer",
        "Disturbance observer",
        law,
        (*kinds, "torque"),
        ("feedforward", "Torque against the observed disturbance of {}"),
        gains,
        limits=limits,
        states=[0.0] * (1 + n * (2 + len(kinds))),
        **options,
    )


@builds(DisturbanceObserverSection)
def _observer_of_section(s: DisturbanceObserverSection, context: LoopContext) -> SymbolicBlock:
    model = assumed_dynamics(context, s.payload) if s.inertia is None else s.inertia
    return disturbance_observer(model, s.time_constant, limits=s.torque_limit, **s.sampling)
