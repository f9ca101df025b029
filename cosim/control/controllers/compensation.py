"""Feedforwards against friction and disturbances, added to the torque of another controller.

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

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, split
from flexfmu.cosim.control.controllers.computed_torque import assumed_dynamics, read
from flexfmu.cosim.control.controllers.joints import JOINTS, Gains, joint_block, limited
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.controllers import DisturbanceObserverSection, FrictionCompensationSection
from flexfmu.model.symbolic import SymbolicBlock


@builds(FrictionCompensationSection)
def friction_compensation(s: FrictionCompensationSection, context: LoopContext) -> SymbolicBlock:
    """Build the block: feedforward = viscous w + coulomb w / sqrt(w² + velocity²), with the motor rate w; without states.

    It is the law of the scene's smooth friction, whose coefficients it has where the section has none. A compensation from the
    measured velocity that is stronger than the friction feeds energy into the loop: keep it below.

    Input: ``joint1.reference.velocity`` or ``joint1.velocity``; output ``joint1.feedforward``. Coefficients are tunable parameters
    ``joint1.viscous_friction``, ``joint1.coulomb_friction``.

    Raises:
        InputError: neither the section nor the robot has friction.
    """
    friction = context.scene.effects.joint_friction
    viscous = friction.viscous if s.viscous is None else s.viscous
    coulomb = friction.coulomb if s.coulomb is None else s.coulomb
    smoothing = getattr(friction, "velocity", 0.01) if s.velocity is None else s.velocity
    if s.viscous is None and s.coulomb is None and not friction.is_there:
        raise InputError(
            f"{context.name} has no friction to compensate: give it `viscous` [N.m.s/rad] or `coulomb` [N.m], or the robot "
            "`effects.joint_friction`"
        )

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        (w,), (d, c) = signals, gains
        return d * w + c * w / casadi.sqrt(w**2 + smoothing**2), x

    return joint_block(
        "friction_compensation",
        "Compensation of the motors' friction",
        law,
        [read("velocity", s.motion)],
        ("feedforward", "Torque against the friction of {}"),
        {
            "viscous_friction": (viscous, "N.m.s/rad", "Viscous friction that is compensated"),
            "coulomb_friction": (coulomb, "N.m", "Dry friction that is compensated"),
        },
        **s.sampling,
    )


@builds(DisturbanceObserverSection)
def disturbance_observer(s: DisturbanceObserverSection, context: LoopContext) -> SymbolicBlock:
    """Build the block of the observer at the top of this module; its output has no direct feedthrough of the torque.

    It must sample at the instants at which the torque changes: a torque that changes in between isn't the one that it reads. With
    inertias in place of inverse dynamics, gravity and all other joints are disturbances of a joint.

    Inputs: ``joint1.position`` (with inverse dynamics), ``joint1.velocity``, ``joint1.torque``; output ``joint1.feedforward``, zero at the
    first sample. Inertias and time constants are tunable parameters ``joint1.inertia``, ``.time_constant``.
    """
    n, h = len(JOINTS), s.sample_time
    gains: Gains = {"time_constant": (s.time_constant, "s", "Time constant of the observer")}
    kinds: tuple[str, ...] = ("velocity",)
    dynamics: casadi.Function | None = None
    if s.inertia is None:
        dynamics, kinds = assumed_dynamics(context, s.payload), ("position", "velocity")
    else:
        gains = {**gains, "inertia": (s.inertia, "kg.m2", "Inertia that the observer assumes")}

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
        limit=s.torque_limit,
        states=[0.0] * (1 + n * (2 + len(kinds))),
        **s.sampling,
    )
