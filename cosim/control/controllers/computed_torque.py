"""Torques of the robot's own dynamics: computed-torque control, and feedforwards of the rigid robot, of gravity and of the flexible robot.

Inverse dynamics ID are those of the rigid robot, (q, v, a) → torque [rad, rad/s, rad/s2 → N.m], with the payload that the section assumes;
`BlockSlave` compiles them.

The torques of the flexible robot's motors in a known motion come from its elastic motion, integrated once from static equilibrium
(`ElasticResponse`). The block holds the mean torque of each sample, so that the hold between samples moves the motors as the torques in
continuous time would.
"""

from __future__ import annotations

from math import ceil
from typing import Literal

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block, rows_in_turn
from flexfmu.cosim.control.controllers.joints import TORQUE, joint_block, joint_outputs, limited
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model import numeric
from flexfmu.model.reference_design.elastic_response import METHOD, SHARED, ElasticResponse, RobotVariant
from flexfmu.model.scene.controllers import ComputedTorqueSection, FeedforwardSection, GravityFeedforwardSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.trajectory import Trajectory

MOTION = "reference.position", "reference.velocity", "reference.acceleration"
"""Arguments of the inverse dynamics."""

STEP = 5e-4
"""Largest step of the integration [s]; it divides the sample time."""


@builds(ComputedTorqueSection)
def computed_torque(s: ComputedTorqueSection, context: LoopContext) -> SymbolicBlock:
    """Build the block: torque = sat(ID(q, v, a_r + K_d (v_r - v) + K_p (q_r - q)) + feedforward).

    Unless saturated, on a rigid robot without feedforward the error e = q_r - q obeys e'' + K_d e' + K_p e = 0 at the sample
    instants at every pose: natural frequency sqrt(K_p), damping ratio K_d / (2 sqrt(K_p)). J. J. Craig, Introduction to
    Robotics, 3rd ed. 2005, section 10.4; B. Siciliano et al., Robotics, 2009, section 8.5.2.

    Inputs: ``joint1.reference.position``, ``.velocity``, ``.acceleration``, ``joint1.position``, ``joint1.velocity``,
    ``joint1.feedforward``; output ``joint1.torque``. Gains are ``joint1.proportional_gain``, ``joint1.derivative_gain``.
    """
    dynamics = assumed_dynamics(context, s.payload)

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        q_r, v_r, a_r, q, v, feedforward = signals
        k_p, k_d, *bounds = gains
        # inverse dynamics of the reference acceleration, corrected by PD feedback
        torque = dynamics.call([q, v, a_r + k_d * (v_r - v) + k_p * (q_r - q)])[0]
        return limited(torque + feedforward, bounds), x

    return joint_block(
        "computed_torque",
        "Computed-torque control: rigid inverse dynamics and PD",
        law,
        (*MOTION, "position", "velocity", "feedforward"),
        TORQUE,
        {
            "proportional_gain": (s.proportional, "1/s2", "Stiffness per inertia"),
            "derivative_gain": (s.derivative, "1/s", "Damping per inertia"),
        },
        limit=s.torque_limit,
        **s.sampling,
    )


@builds(GravityFeedforwardSection)
def gravity_feedforward(s: GravityFeedforwardSection, context: LoopContext) -> SymbolicBlock:
    """Build the block: feedforward = ID(q, 0, 0), the torques that hold the rigid robot at rest in its pose q; without states.

    It reads the reference, which is known ahead and free of noise, or the measurement, which is there without a reference too
    (B. Siciliano et al., Robotics, 2009, section 8.5.1).

    Input: ``joint1.reference.position`` or ``joint1.position``; output ``joint1.feedforward``.
    """
    dynamics = assumed_dynamics(context, s.payload)

    def law(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        rest = casadi.SX.zeros(signals[0].numel())
        return dynamics.call([*signals, rest, rest])[0], x

    gives, takes = ("feedforward", "Torque against gravity of {}"), [read("position", s.motion)]
    what = "Torques that hold the rigid robot at rest"
    return joint_block("gravity_feedforward", what, law, takes, gives, {}, **s.sampling)


@builds(FeedforwardSection)
def feedforward(s: FeedforwardSection, context: LoopContext) -> SymbolicBlock:
    """Build the block of the torques in the reference motion, outputs ``joint1.feedforward``.

    For the rigid robot they are ID(q_r, v_r, a_r) of its inputs ``joint1.reference.position``, ``.velocity``, ``.acceleration``; for
    the flexible robot the mean torques of each sample in turn, without inputs.

    Raises:
        EquilibriumError: the links are too soft for the motion.
    """
    if s.robot == "rigid":
        dynamics = assumed_dynamics(context, s.payload)
        gives = "feedforward", "Rigid torque of the reference motion of {}"
        what = "Rigid inverse dynamics of the reference motion"
        return joint_block(
            "feedforward", what, lambda x, u, p: (dynamics.call(u)[0], x), MOTION, gives, {}, **s.sampling
        )
    scene, motion = _assumed(context, s.payload), context.shaped
    torques = mean_torques(scene, motion, motion.duration + scene.trajectory.dwell, **s.sampling)
    if s.correction:
        indices = np.minimum(np.arange(len(torques)), len(s.correction) - 1)
        torques = torques + np.array(s.correction)[indices]
    return block(
        "feedforward",
        "Torques of the flexible robot in its motion",
        rows_in_turn(torques, "torques"),
        inputs=(),
        outputs=joint_outputs("feedforward", "Torque of the flexible robot's motion of {}"),
        states=(0.0,),
        symbol=casadi.MX,
        **s.sampling,
    )


def mean_torques(
    scene: Scene, joints: Trajectory, stop_time: float, sample_time: float, offset: float = 0.0
) -> RealArray:
    """Mean motor torques of each sample, (N, 2) [N m], from static equilibrium on.

    Args:
        scene: the robot, with its payload.
        joints: motion of the motors q11, q21 [rad]; they rest after it.
        stop_time: how long the robot is simulated [s]; the last torque holds on.
        sample_time, offset: sample time and first sample instant [s].

    Raises:
        EquilibriumError: the links are too soft for the motion.
    """
    # equal steps, some of them before the first sample and after the last one, so that each `SHARED` of them share a matrix
    before, count = ceil(offset / sample_time), max(1, ceil((stop_time - offset) / sample_time))
    total, parts = SHARED * ceil((before + count) / SHARED), ceil(sample_time / STEP)
    duration, start = total * sample_time, joints.evaluate(0.0, 0, "left")[0, 0]
    # a robot's functions are kept, and serve every loop around it
    robot = RobotVariant(scene.replace({"controller": [], "imperfection": []}))
    response = ElasticResponse([robot], start, total * parts, shared=SHARED)
    instants = offset - before * sample_time + duration * response.fractions
    # the motors rest before and after the motion
    references = joints.evaluate(np.clip(instants, 0.0, joints.duration), 2, "left")
    references[1:, (instants < 0.0) | (instants > joints.duration)] = 0.0
    torques = response.respond(np.hstack(list(references)), duration).torque[0]
    # the mean over a step by the weights of Gauss's quadrature, then over a sample
    means = np.einsum("s,kpsj->kj", METHOD.whole, torques.reshape(total, parts, 3, 2)) / parts
    return np.asarray(means[before : before + count])


def assumed_dynamics(context: LoopContext, payload: float | None) -> casadi.Function:
    """Return the rigid inverse dynamics with the payload [kg] that a controller assumes; None for the scene's own."""
    return numeric.inverse_dynamics(_assumed(context, payload))


def _assumed(context: LoopContext, payload: float | None) -> Scene:
    """The scene with the payload [kg] that a controller assumes."""
    return context.scene if payload is None else context.scene.replace({"payload.mass": payload})


def read(kind: str, motion: Literal["reference", "measured"]) -> str:
    """Return the name of the signal that a feedforward reads: that of the reference, or the measured one."""
    return f"reference.{kind}" if motion == "reference" else kind
