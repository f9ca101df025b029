"""Disturbance observer: estimates the torque that the model lacks from the motion, and feeds it forward.

At the instant k, with the torque T_k-1 that was held since the last instant, sample time h, the mean velocity w between both instants and
the mean angle q, and the model's torque ID for the measured acceleration::

    f_k = a f_k-1 + (1 - a) (T_k-1 - ID(q, w, (w_k - w_k-1) / h))        a = exp(-h / T)

On a joint with the inertia that the model assumes, under a held torque and a constant disturbance d, the bracket is -d exactly, so that
f_k = -d (1 - a^k) whatever the torques are. K. Ohnishi, M. Shibata, T. Murakami, Motion control for advanced mechatronics, IEEE/ASME
Trans. Mechatronics 1 (1996) 56, with the difference quotient in place of the derivative.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.controllers.computed_torque import assumed_dynamics, check_dynamics
from flexfmu.cosim.control.controllers.joints import (
    JOINTS,
    Limits,
    PerJoint,
    feedforward_outputs,
    gains,
    measurements,
    saturate,
    torque_limits,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.model.scene.controllers import DisturbanceObserverSection
from flexfmu.model.symbolic import SymbolicBlock, Variable


def disturbance_observer(
    model: casadi.Function | PerJoint,
    time_constant: PerJoint,
    *,
    sample_time: float,
    offset: float = 0.0,
    limits: Limits | None = None,
    joints: Sequence[str] = JOINTS,
    name: str = "disturbance_observer",
) -> SymbolicBlock:
    """Build the block of the law at the top of this module; its output has no direct feedthrough of the torque.

    It must sample at the instants at which the torque changes: a torque that changes in between isn't the one that it reads.

    Inputs: ``joint1.position`` (with inverse dynamics), ``joint1.velocity``, ``joint1.torque``; output ``joint1.feedforward``, zero at the
    first sample. Inertias, time constants and limits are tunable parameters ``joint1.inertia``, ``.time_constant``, ``.torque.minimum``,
    ``.torque.maximum``.

    Args:
        model: inverse dynamics (q, v, a) → torque [rad, rad/s, rad/s2 → N.m] of the robot without the disturbance, or the inertia of each
            joint [kg.m2], of which then gravity and all other joints are disturbances.
        time_constant: T [s], zero or positive: 1 / (2 pi f) for a bandwidth f [Hz].
        sample_time, offset: sample time and first sample instant [s].
        limits: limits of the feedforward; None for none.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: the inverse dynamics don't fit the joints, a time constant or inertia is negative or not finite, or the sample time isn't
            positive.
    """
    n, h = len(joints), sample_time
    dynamics = model if isinstance(model, casadi.Function) else None
    inertias: list[Variable] = []
    if isinstance(model, casadi.Function):
        check_dynamics(model, joints, name)
    else:
        inertias = gains(joints, "inertia", model, "kg.m2", "Inertia that the observer assumes")
    kinds = ("velocity",) if dynamics is None else ("position", "velocity")

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        started, feedforward, last_torque, *last = split(x, 1, n)
        *now, torque = split(u, n)
        time, *rest = split(p, n)
        # the torque of the model for the motion since the last instant
        means = [0.5 * (each + before) for each, before in zip(now, last, strict=True)]
        acceleration = (now[-1] - last[-1]) / h
        known = rest[0] * acceleration if dynamics is None else dynamics.call([*means, acceleration])[0]
        # the filtered difference; nothing is known at the first sample
        a = casadi.exp(-h / time)
        estimate = a * feedforward + (1.0 - a) * (last_torque - known)
        feedforward = casadi.if_else(casadi.repmat(started, n, 1), estimate, 0.0)
        output = saturate(feedforward, *rest[-2:]) if limits else feedforward
        return output, casadi.vertcat(1.0, feedforward, torque, *now)

    return block(
        name,
        "Disturbance observer",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=[*measurements(joints, *kinds), *(_torque_input(joint) for joint in joints)],
        outputs=feedforward_outputs(joints, "Torque against the observed disturbance"),
        parameters=[
            *gains(joints, "time_constant", time_constant, "s", "Time constant of the observer"),
            *inertias,
            *(limits.parameters(joints) if limits else ()),
        ],
        states=[0.0] * (1 + n * (2 + len(kinds))),
    )


def _torque_input(joint: str) -> Variable:
    return Variable(f"{joint}.torque", "N.m", f"Torque that drives {joint}", "input", 0.0)


@builds(DisturbanceObserverSection)
def _from_section(section: DisturbanceObserverSection, context: LoopContext) -> SymbolicBlock:
    model = assumed_dynamics(context, section.payload) if section.inertia is None else section.inertia
    return disturbance_observer(
        model,
        section.time_constant,
        limits=torque_limits(section.torque_limit),
        sample_time=section.sample_time,
        offset=section.offset,
    )
