"""What stands between the planned motion and the robot: controllers, shapers and imperfections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from flexfmu.cosim.control.imperfections.payload_error import PayloadError, with_payload_error
from flexfmu.cosim.control.shapers import Shaper
from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.experiment.planning import APPLICATIONS, MotionPlan, shape_joints
from flexfmu.cosim.experiment.user_slaves import SlaveNames, as_slave
from flexfmu.cosim.experiment.wiring import InlineBlock, inline_block
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.trajectory import Trajectory


@dataclass(frozen=True)
class Loop:
    """What stands between the planned motion and the robot.

    Attributes:
        motion: the planned motion with shapers, as a perfect controller would follow it.
        driving: joint trajectory that is streamed; that of the motion but for sampled shapers.
        controllers: slaves that output torques (or whatever the robot takes).
        inline_blocks: slaves that signals pass.
        connect: ``slave.input`` → source, beyond equal names.
        parameters: parameters of the robot that differ from the scene's.
    """

    motion: MotionPlan
    driving: Trajectory
    controllers: tuple[Slave, ...] = ()
    inline_blocks: tuple[InlineBlock, ...] = ()
    connect: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ShapedMotion:
    """A motion with its shapers.

    Attributes:
        motion: with all shapers.
        driving: joint trajectory that is streamed; that of the motion but for sampled shapers.
        inline_blocks: the sampled shapers, and others that are slaves.
    """

    motion: MotionPlan
    driving: Trajectory
    inline_blocks: tuple[InlineBlock, ...] = ()


def make_loop(
    motion: MotionPlan,
    controllers: Iterable[Any] = (),
    shapers: Iterable[Any] = (),
    imperfections: Iterable[Any] = (),
    connect: Mapping[str, str] | None = None,
) -> Loop:
    """A loop of blocks, slaves, python-control systems and FMU files.

    Args:
        motion: the scene's planned motion.
        controllers: what calculates torques from references and measurements.
        shapers: `Shaper`, a bare `ImpulseSequence` for the joint references, or what else references may pass.
        imperfections: what signals pass on their way, in this order, or `PayloadError`.
        connect: ``slave.input`` → source, beyond equal names.

    Raises:
        InputError: something is of a kind that can't be a slave.
        TrajectoryError: a shaper can't act on this motion.
    """
    names = SlaveNames()
    return close_loop(shape(motion, list(shapers), names), controllers, imperfections, connect or {}, names)


def close_loop(
    shaped: ShapedMotion,
    controllers: Iterable[Any],
    imperfections: Iterable[Any],
    connect: Mapping[str, str],
    names: SlaveNames,
) -> Loop:
    """A loop about a motion whose shapers have acted; otherwise as `make_loop`.

    Args:
        shaped: the motion with its shapers.
        controllers, imperfections, connect: as for `make_loop`.
        names: names given so far.
    """
    acting = tuple(as_slave(each, names) for each in controllers)
    inline_blocks, parameters = list(shaped.inline_blocks), dict[str, float]()
    for each in imperfections:
        if isinstance(each, PayloadError):
            parameters["payload.mass"] = with_payload_error(shaped.motion.scene, each.relative).payload.mass
        else:
            inline_blocks.append(inline_block(as_slave(each, names)))
    return Loop(shaped.motion, shaped.driving, acting, tuple(inline_blocks), dict(connect), parameters)


def shape(
    motion: MotionPlan,
    shapers: Sequence[Any],
    names: SlaveNames,
    repeat: Callable[[MotionPlan], MotionPlan] = lambda motion: motion,
) -> ShapedMotion:
    """Let the shapers act, those along the path first, sampled ones as slaves.

    Args:
        motion: the planned motion.
        shapers: as for `make_loop`.
        names: names given so far.
        repeat: repeats the motion that is streamed.

    Raises:
        InputError: something is of a kind that can't be a slave.
        TrajectoryError: a shaper can't act on this motion.
    """
    if not shapers:
        motion = repeat(motion)
        return ShapedMotion(motion, motion.joints)

    # shapers that change the planned motion: along the path, then of the joints
    chosen = [Shaper(each) if isinstance(each, ImpulseSequence) else each for each in shapers]
    for place in ("path", "joints"):
        for each in chosen:
            if isinstance(each, Shaper) and each.apply == place:
                motion = APPLICATIONS[place](motion, each.sequence)
    motion = repeat(motion)
    # shapers that act in the loop, sample by sample; the motion is what they make of it
    driving, inline_blocks = motion.joints, []
    for each in chosen:
        if not isinstance(each, Shaper):
            inline_blocks.append(inline_block(as_slave(each, names)))
        elif each.sample_time is not None:
            from flexfmu.cosim.control.shaper_block import shaper_block

            block = shaper_block(each.sequence, each.sample_time, offset=each.offset, name=each.name)
            inline_blocks.append(inline_block(as_slave(block, names)))
            # the streamed motion is shaped, and so is what it repeats
            sequence = each.sequence.split(each.sample_time)
            shaped = shape_joints(motion, sequence)
            if motion.repetition is not None:
                once = shape_joints(motion.once, sequence)
                shaped = replace(shaped, repetition=replace(motion.repetition, once=once))
            motion = shaped
    return ShapedMotion(motion, driving, tuple(inline_blocks))
