"""Computed-torque control, and the rigid inverse dynamics of the reference motion as a feedforward alone."""

from __future__ import annotations

from collections.abc import Sequence

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.controllers.flexible_feedforward import mean_torques, tabulated_feedforward
from flexfmu.cosim.control.controllers.joints import (
    JOINTS,
    JointQuantity,
    Limits,
    PerJoint,
    feedforward_outputs,
    feedforwards,
    gains,
    measurements,
    references,
    torque_equations,
    torque_limits,
    torques,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.scene.controllers import ComputedTorqueSection, FeedforwardSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock

MOTION: tuple[JointQuantity, ...] = ("position", "velocity", "acceleration")
"""Arguments of the inverse dynamics."""


def computed_torque(
    inverse_dynamics: casadi.Function,
    proportional: PerJoint,
    derivative: PerJoint,
    *,
    sample_time: float,
    offset: float = 0.0,
    limits: Limits | None = None,
    joints: Sequence[str] = JOINTS,
    name: str = "computed_torque",
) -> SymbolicBlock:
    """Build the block: torque = sat(ID(q, v, a_r + K_d (v_r - v) + K_p (q_r - q)) + feedforward).

    ID is the rigid inverse dynamics. Unless saturated, on a rigid robot without feedforward the error e = q_r - q obeys
    e'' + K_d e' + K_p e = 0 at the sample instants at every pose: natural frequency sqrt(K_p), damping ratio
    K_d / (2 sqrt(K_p)). J. J. Craig, Introduction to
    Robotics, 3rd ed. 2005, section 10.4; B. Siciliano et al., Robotics, 2009, section 8.5.2.

    Inputs: ``joint1.reference.position``, ``.velocity``, ``.acceleration``, ``joint1.position``, ``joint1.velocity``,
    ``joint1.feedforward`` (zero unless connected); output ``joint1.torque``. Gains and limits are tunable parameters
    ``joint1.proportional_gain``, ``joint1.derivative_gain``, ``joint1.torque.minimum``, ``joint1.torque.maximum``.
    `BlockSlave` compiles large inverse dynamics, such as those of a five-bar.

    Args:
        inverse_dynamics: (q, v, a) → torque [rad, rad/s, rad/s2 → N.m], for example that of
            `flexfmu.model.numeric.inverse_dynamics`.
        proportional: K_p [1/s2].
        derivative: K_d [1/s].
        sample_time: time between samples [s].
        offset: first sample instant [s].
        limits: torque limits; None for none.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: the inverse dynamics don't fit the joints, a gain is negative or not finite, or the sample time
            isn't positive.
    """
    check_dynamics(inverse_dynamics, joints, name)

    def law(x: Vector, signals: list[Vector], k: list[Vector]) -> tuple[Vector, Vector]:
        q_r, v_r, a_r, q, v = signals
        k_p, k_d = k
        # inverse dynamics of the reference acceleration, corrected by PD feedback
        return inverse_dynamics.call([q, v, a_r + k_d * (v_r - v) + k_p * (q_r - q)])[0], x

    return block(
        name,
        "Computed-torque control: rigid inverse dynamics and PD",
        torque_equations(law, joints, limits),
        sample_time=sample_time,
        offset=offset,
        inputs=[*references(joints, *MOTION), *measurements(joints, "position", "velocity"), *feedforwards(joints)],
        outputs=torques(joints),
        parameters=[
            *gains(joints, "proportional_gain", proportional, "1/s2", "Stiffness per inertia"),
            *gains(joints, "derivative_gain", derivative, "1/s", "Damping per inertia"),
            *(limits.parameters(joints) if limits else ()),
        ],
    )


def inverse_dynamics_feedforward(
    inverse_dynamics: casadi.Function,
    *,
    sample_time: float,
    offset: float = 0.0,
    joints: Sequence[str] = JOINTS,
    name: str = "feedforward",
) -> SymbolicBlock:
    """Build the block: feedforward = ID(q_r, v_r, a_r), the rigid torques of the reference motion.

    Connect it to the feedforward input of a PD or PID controller.

    Inputs: ``joint1.reference.position``, ``.velocity``, ``.acceleration``; output ``joint1.feedforward``. Arguments
    and errors as for `computed_torque`.
    """
    check_dynamics(inverse_dynamics, joints, name)

    # a function of the references alone, without states
    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        return inverse_dynamics.call(split(u, len(joints)))[0], x

    return block(
        name,
        "Rigid inverse dynamics of the reference motion",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=references(joints, *MOTION),
        outputs=feedforward_outputs(joints, "Rigid torque of the reference motion"),
    )


def check_dynamics(inverse_dynamics: casadi.Function, joints: Sequence[str], name: str) -> None:
    """Check that the inverse dynamics map three vectors to one, each with one element for each joint.

    Raises:
        InputError: they don't.
    """
    found = [inverse_dynamics.numel_in(i) for i in range(inverse_dynamics.n_in())]
    results = [inverse_dynamics.numel_out(i) for i in range(inverse_dynamics.n_out())]
    n = len(joints)
    if found != [n] * 3 or results != [n]:
        raise InputError(
            f"{name}: the inverse dynamics must take (q, v, a) of {n} each and give {n} torques for {', '.join(joints)}; "
            f"{inverse_dynamics.name()} takes {found} and gives {results}"
        )


@builds(ComputedTorqueSection)
def _from_section(section: ComputedTorqueSection, context: LoopContext) -> SymbolicBlock:
    return computed_torque(
        assumed_dynamics(context, section.payload),
        section.proportional,
        section.derivative,
        limits=torque_limits(section.torque_limit),
        sample_time=section.sample_time,
        offset=section.offset,
    )


@builds(FeedforwardSection)
def _feedforward_from_section(section: FeedforwardSection, context: LoopContext) -> SymbolicBlock:
    if section.robot == "flexible":
        return _flexible_feedforward(section, context)
    dynamics = assumed_dynamics(context, section.payload)
    return inverse_dynamics_feedforward(dynamics, sample_time=section.sample_time, offset=section.offset)


def assumed_dynamics(context: LoopContext, payload: float | None) -> casadi.Function:
    """Return the rigid inverse dynamics with the payload [kg] that a controller assumes; None for the scene's own."""
    return inverse_dynamics(_assumed(context, payload))


def _flexible_feedforward(section: FeedforwardSection, context: LoopContext) -> SymbolicBlock:
    """The torques of the flexible robot in the motion that runs."""
    scene, motion = _assumed(context, section.payload), context.shaped
    torques = mean_torques(scene, motion, motion.duration + scene.trajectory.dwell, section.sample_time, section.offset)
    return tabulated_feedforward(torques, sample_time=section.sample_time, offset=section.offset)


def _assumed(context: LoopContext, payload: float | None) -> Scene:
    """The scene with the payload [kg] that a controller assumes."""
    return context.scene if payload is None else context.scene.replace({"payload.mass": payload})
