"""Feedforward of the torques with which the motors of the flexible robot make a known motion.

The elastic motion under the references is integrated once, from static equilibrium (`ElasticResponse`). The block holds the mean
torque of each sample, so that the hold between samples moves the motors as the torques in continuous time would.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import block, rows_in_turn
from flexfmu.cosim.control.controllers.joints import JOINTS, feedforward_outputs
from flexfmu.model.radau import radau
from flexfmu.model.reference_design.elastic_response import ElasticResponse
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import Trajectory

STEP = 5e-4
"""Largest step of the integration [s]; it divides the sample time."""


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
    # equal steps, some of them before the first sample
    before, count = ceil(offset / sample_time), max(1, ceil((stop_time - offset) / sample_time))
    duration, parts = (before + count) * sample_time, ceil(sample_time / STEP)
    response = ElasticResponse(scene, [{}], joints.evaluate(0.0, 0, "left")[0, 0], (before + count) * parts)
    instants = offset - before * sample_time + duration * response.fractions
    # the motors rest before and after the motion
    references = joints.evaluate(np.clip(instants, 0.0, joints.duration), 2, "left")
    references[1:, (instants < 0.0) | (instants > joints.duration)] = 0.0
    torques = response.respond(np.hstack(list(references)), duration).torque[0]
    # the mean over a step by the weights of Radau's quadrature, then over a sample
    means = np.einsum("s,kpsj->kj", radau(3).matrix[-1], torques.reshape(before + count, parts, 3, 2)) / parts
    return np.asarray(means[before:])


def tabulated_feedforward(
    torques: RealArray,
    *,
    sample_time: float,
    offset: float = 0.0,
    joints: Sequence[str] = JOINTS,
    name: str = "feedforward",
) -> SymbolicBlock:
    """Build the block: the torques of each sample in turn, (N, n) [N m] for n joints; the last ones hold on.

    It has no inputs; outputs ``joint1.feedforward``.

    Args:
        torques: the torques.
        sample_time, offset: sample time and first sample instant [s].
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: the sample time isn't positive.
    """
    return block(
        name,
        "Torques of the flexible robot in its motion",
        rows_in_turn(torques, "torques"),
        sample_time=sample_time,
        offset=offset,
        inputs=(),
        outputs=feedforward_outputs(joints, "Torque of the flexible robot's motion"),
        states=(0.0,),
        symbol=casadi.MX,
    )
