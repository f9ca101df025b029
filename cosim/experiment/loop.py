"""The loop around the robot: planned motion, controllers, shapers and imperfections."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.experiment.planning import APPLICATIONS, MotionPlan, shape_joints
from flexfmu.cosim.experiment.user_slaves import SlaveNames, as_slave
from flexfmu.cosim.experiment.wiring import InlineBlock, inline_block
from flexfmu.trajectories.trajectory import Trajectory

if TYPE_CHECKING:
    from flexfmu.cosim.control.shapers import Shaper


@dataclass(frozen=True)
class Loop:
    """The loop around the robot: planned motion, controllers, shapers and imperfections.

    Attributes:
        motion: the planned motion with all shapers.
        driving: joint trajectory of the references; equal to that of the motion, but without sampled shapers.
        controllers: slaves that output torques or other inputs of the robot.
        inline_blocks: slaves in series with signals.
        connect: ``slave.input`` → source, beyond equal names.
        parameters: parameters of the robot that differ from the scene's.
        disturbances: slaves that output forces, torques and masses that disturb the robot.
    """

    motion: MotionPlan
    driving: Trajectory
    controllers: tuple[Slave, ...] = ()
    inline_blocks: tuple[InlineBlock, ...] = ()
    connect: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    disturbances: tuple[Slave, ...] = ()


def shape(
    motion: MotionPlan,
    shapers: Sequence[Shaper | Slave],
    names: SlaveNames,
    repeat: Callable[[MotionPlan], MotionPlan],
) -> Loop:
    """Apply the shapers: along the path, then of the joints, then sampled ones as slaves of a loop without controllers.

    Args:
        motion: the planned motion.
        shapers: `flexfmu.cosim.control.shapers.Shaper`, or slaves in series with references.
        names: names assigned so far.
        repeat: function that repeats the motion, for cycles or learning controllers; applied before the sampled shapers.

    Raises:
        TrajectoryError: a shaper can't act on this motion.
    """
    if not shapers:
        motion = repeat(motion)
        return Loop(motion, motion.joints)

    from flexfmu.cosim.control.shapers import Shaper

    # shapers that change the planned motion: along the path, then of the joints
    for place in ("path", "joints"):
        for each in shapers:
            if isinstance(each, Shaper) and each.apply == place:
                motion = APPLICATIONS[place](motion, each.sequence)
    motion = repeat(motion)
    # sampled shapers act in the loop; the motion includes their effect
    driving, inline_blocks = motion.joints, []
    for each in shapers:
        if not isinstance(each, Shaper):
            inline_blocks.append(inline_block(each))
        elif each.sample_time is not None:
            from flexfmu.cosim.control.shapers import shaper_block

            block = shaper_block(each.sequence, each.sample_time, offset=each.offset, name=each.name)
            inline_blocks.append(inline_block(as_slave(block, names)))
            # shape the motion and its single repetition
            sequence = each.sequence.split(each.sample_time)
            shaped = shape_joints(motion, sequence)
            if motion.repetition is not None:
                once = shape_joints(motion.once, sequence)
                shaped = replace(shaped, repetition=replace(motion.repetition, once=once))
            motion = shaped
    return Loop(motion, driving, inline_blocks=tuple(inline_blocks))
