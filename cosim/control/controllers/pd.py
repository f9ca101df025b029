"""PD control of the joints, from measured angles and rates."""

from __future__ import annotations

from collections.abc import Sequence

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.gain_schedule import with_schedule
from flexfmu.cosim.control.controllers.joints import (
    JOINTS,
    Limits,
    PerJoint,
    feedforwards,
    gains,
    measurements,
    references,
    torque_equations,
    torque_limits,
    torques,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.model.scene.controllers import PdSection
from flexfmu.model.symbolic import SymbolicBlock


def pd(
    proportional: PerJoint,
    derivative: PerJoint,
    *,
    sample_time: float,
    offset: float = 0.0,
    limits: Limits | None = None,
    joints: Sequence[str] = JOINTS,
    name: str = "pd",
) -> SymbolicBlock:
    """Build the block: torque = sat(K_p (q_r - q) + K_d (v_r - v) + feedforward) for each joint, without states.

    Inputs: ``joint1.reference.position``, ``.velocity``, ``joint1.position``, ``joint1.velocity``,
    ``joint1.feedforward`` (zero unless connected); output ``joint1.torque``. Gains and limits are tunable parameters
    ``joint1.proportional_gain``, ``joint1.derivative_gain``, ``joint1.torque.minimum``, ``joint1.torque.maximum``.

    Args:
        proportional: K_p [N.m/rad].
        derivative: K_d [N.m.s/rad].
        sample_time: time between samples [s].
        offset: first sample instant [s].
        limits: torque limits; None for none.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: a gain is negative or not finite, their number doesn't fit, or the sample time isn't positive.
    """

    def law(x: Vector, signals: list[Vector], k: list[Vector]) -> tuple[Vector, Vector]:
        q_r, v_r, q, v = signals
        k_p, k_d = k
        return k_p * (q_r - q) + k_d * (v_r - v), x

    return block(
        name,
        "PD control of the joints",
        torque_equations(law, joints, limits),
        sample_time=sample_time,
        offset=offset,
        inputs=[
            *references(joints, "position", "velocity"),
            *measurements(joints, "position", "velocity"),
            *feedforwards(joints),
        ],
        outputs=torques(joints),
        parameters=[
            *gains(joints, "proportional_gain", proportional, "N.m/rad", "Proportional gain"),
            *gains(joints, "derivative_gain", derivative, "N.m.s/rad", "Derivative gain"),
            *(limits.parameters(joints) if limits else ()),
        ],
    )


GAINS = {"proportional": "proportional_gain", "derivative": "derivative_gain"}
"""Key of a schedule → gain."""


@builds(PdSection)
def _from_section(section: PdSection, context: LoopContext) -> SymbolicBlock:
    controller = pd(
        section.proportional,
        section.derivative,
        limits=torque_limits(section.torque_limit),
        sample_time=section.sample_time,
        offset=section.offset,
    )
    return with_schedule(controller, section.schedule, GAINS, context)
