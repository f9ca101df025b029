"""P-type iterative learning: a feedforward torque that improves from cycle to cycle of a repeated motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.controllers.joints import (
    JOINTS,
    JointQuantity,
    PerJoint,
    feedforward_outputs,
    gains,
    measurements,
    references,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.controllers import LearningSection
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.trajectory import SAME_TIME

MAXIMUM_TABLE = 1_000_000
"""Largest number of samples in a cycle; more are probably a mistake in the cycle's unit."""

GAIN_UNITS: Mapping[JointQuantity, str] = {"position": "N.m/rad", "velocity": "N.m.s/rad", "acceleration": "N.m.s2/rad"}
"""Quantity whose error is learned from → unit of the learning gain."""


def iterative_learning(
    gain: PerJoint,
    cycle: int,
    *,
    sample_time: float,
    offset: float = 0.0,
    shift: int = 1,
    forgetting: float = 0.0,
    learn_from: JointQuantity = "position",
    joints: Sequence[str] = JOINTS,
    name: str = "learning",
) -> SymbolicBlock:
    """Build the block whose output w is the learned feedforward: for each joint, cycle j and sample k = 0 .. N - 1 ::

        w_j+1(k) = (1 - forgetting) w_j(k) + gain * e_j(k + shift),      w_0 = 0,      e = reference - measurement

    P-type learning (S. Arimoto, S. Kawamura, F. Miyazaki, Bettering operation of robots by learning, J. Robotic Systems
    1 (1984) 123; forgetting: S. Arimoto, Int. J. Control 52 (1990)). On a sampled plant with first Markov parameter
    g = y(shift) of a unit pulse, the error of a sample changes from cycle to cycle by the factor 1 - forgetting - gain
    g, whose magnitude must be below 1. The errors of the last ``shift`` samples lie beyond the cycle, so those samples
    learn nothing.

    Every cycle must start from the same state of the plant: repeat a motion that returns to its start. Inputs:
    ``joint1.reference.position`` and ``joint1.position`` (or ``velocity``); output ``joint1.feedforward``, to be added
    to a controller's torque, without direct feedthrough. The gain is tunable: ``joint1.learning_gain``.

    Args:
        gain: learning gain [N.m/rad] (or [N.m.s/rad] for velocities).
        cycle: N, samples in a cycle.
        sample_time: time between samples [s].
        offset: first sample instant [s].
        shift: samples from a torque to the error that it causes; 1 for a sampled plant without direct feedthrough.
        forgetting: share that is forgotten in each cycle, from 0 to below 1; a few percent add robustness and leave an
            error.
        learn_from: quantity whose error is learned from: ``position``, ``velocity`` or ``acceleration``.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: cycle, shift, forgetting, a gain or the sample time is out of range.
    """
    if cycle != int(cycle) or not 1 <= cycle <= MAXIMUM_TABLE:
        raise InputError(f"{name}: a cycle must have 1 to {MAXIMUM_TABLE} samples, got {cycle}")
    if shift != int(shift) or not 0 <= shift < cycle:
        raise InputError(f"{name}: the shift must be 0 to {cycle - 1} samples, less than a cycle, got {shift}")
    if not (isfinite(forgetting) and 0.0 <= forgetting < 1.0):
        raise InputError(f"{name}: the forgetting must be at least 0 and below 1, got {forgetting}")

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        # states: number of the sample within the cycle, and each joint's torques of the next N samples
        n, (k, *queues) = len(joints), split(x, 1, cycle)
        errors = casadi.if_else(k >= shift, u[:n] - u[n:], casadi.MX.zeros(n))
        moved = [_move_on(queues[i], p[i] * errors[i], shift, forgetting) for i in range(n)]
        # the number starts from zero in every cycle
        following = casadi.if_else(k + 1.0 >= cycle, 0.0, k + 1.0)
        return casadi.vertcat(*(queue[0] for queue in queues)), casadi.vertcat(following, *moved)

    return block(
        name,
        "P-type iterative learning over cycles",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=[*references(joints, learn_from), *measurements(joints, learn_from)],
        outputs=feedforward_outputs(joints, "Learned torque"),
        parameters=gains(joints, "learning_gain", gain, GAIN_UNITS[learn_from], "Learning gain"),
        states=[0.0] * (1 + len(joints) * cycle),
        symbol=casadi.MX,
    )


def _move_on(queue: Vector, correction: Vector, shift: int, forgetting: float) -> Vector:
    """Return the queue (N,) of a joint's torques one sample later.

    Its head is the present torque, which moves to the end. The torque of ``shift`` samples ago, which is ``shift``
    places before the end, learns from the present error.
    """
    cycle = queue.numel()
    learner = (cycle - shift) % cycle
    learned = (1.0 - forgetting) * queue[learner] + correction
    if learner == 0:
        return casadi.vertcat(queue[1:, 0], learned)
    return casadi.vertcat(queue[1:learner, 0], learned, queue[learner + 1 :, 0], queue[0])


def samples_in_a_cycle(period: float | None, sample_time: float) -> int:
    """Return the number of samples in a cycle of a repeated motion.

    Args:
        period: of the cycle [s]; None for a motion that isn't repeated.
        sample_time: [s].

    Raises:
        InputError: the motion isn't repeated, or a cycle isn't a whole number of samples.
    """
    if period is None:
        raise InputError(
            "learning needs a motion that is repeated: flexfmu.cosim.experiment.cycles.repeated(plan, cycles)"
        )
    # the queue has one torque for each sample of a cycle
    samples = round(period / sample_time)
    if abs(samples * sample_time - period) > SAME_TIME * period:
        raise InputError(
            f"a cycle of {period} s isn't a whole number of samples of {sample_time} s; choose another dwell, or "
            "repeated(.., sample_time=..), which lengthens it"
        )
    return samples


@builds(LearningSection)
def _from_section(section: LearningSection, context: LoopContext) -> SymbolicBlock:
    return iterative_learning(
        section.gain,
        samples_in_a_cycle(context.period, section.sample_time),
        shift=section.lead,
        forgetting=section.forgetting,
        sample_time=section.sample_time,
        offset=section.offset,
    )
