"""The loop around the robot: planned motion, controllers, shapers and imperfections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.experiment.feedforwards import with_sum
from flexfmu.cosim.experiment.planning import APPLICATIONS, MotionPlan, shape_joints
from flexfmu.cosim.experiment.user_slaves import SlaveNames, as_slave
from flexfmu.cosim.experiment.wiring import InlineBlock, inline_block
from flexfmu.trajectories.trajectory import Trajectory


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


def make_loop(
    motion: MotionPlan,
    controllers: Iterable[Any] = (),
    shapers: Iterable[Any] = (),
    imperfections: Iterable[Any] = (),
    connect: Mapping[str, str] | None = None,
    repeat: Callable[[MotionPlan], MotionPlan] = lambda motion: motion,
    disturbances: Iterable[Any] = (),
) -> Loop:
    """Make a loop of blocks, slaves, python-control systems and FMU files, see `as_slave`.

    Args:
        motion: the scene's planned motion.
        controllers: slaves that calculate torques from references and measurements.
        shapers: `Shaper`, `ImpulseSequence` for the joint references, or slaves in series with references.
        imperfections: slaves in series with signals, in this order, or `PayloadError`.
        connect: ``slave.input`` → source, beyond equal names.
        repeat: as for `shape`.
        disturbances: blocks of `flexfmu.cosim.control.disturbances`, or other slaves without inputs that the robot needs.

    Raises:
        InputError: something is of a kind that can't be a slave.
        TrajectoryError: a shaper can't act on this motion.
    """
    names = SlaveNames()
    shaped = shape(motion, list(shapers), names, repeat)
    return close_loop(shaped, controllers, imperfections, connect or {}, names, disturbances)


def close_loop(
    shaped: Loop,
    controllers: Iterable[Any],
    imperfections: Iterable[Any],
    connect: Mapping[str, str],
    names: SlaveNames,
    disturbances: Iterable[Any] = (),
) -> Loop:
    """Complete the loop of a motion to which the shapers have been applied; errors as for `make_loop`.

    Args:
        shaped: the motion with its shapers, by `shape`.
        controllers, imperfections, connect: as for `make_loop`.
        names: names assigned so far.
        disturbances: as for `make_loop`.
    """
    acting = with_sum([as_slave(each, names) for each in controllers], connect, names)
    inline_blocks, parameters = list(shaped.inline_blocks), dict[str, float]()
    for each in imperfections:
        from flexfmu.cosim.control.imperfections.payload_error import PayloadError, with_payload_error

        if isinstance(each, PayloadError):
            parameters["payload.mass"] = with_payload_error(shaped.motion.scene, each.relative).payload.mass
        else:
            inline_blocks.append(inline_block(as_slave(each, names)))
    disturbing = [as_slave(each, names) for each in disturbances]
    if disturbing:
        from flexfmu.cosim.control.sums import with_sums

        disturbing = with_sums(disturbing, names.unused)
    return replace(
        shaped,
        controllers=acting,
        inline_blocks=tuple(inline_blocks),
        connect=dict(connect),
        parameters=parameters,
        disturbances=tuple(disturbing),
    )


def shape(
    motion: MotionPlan,
    shapers: Sequence[Any],
    names: SlaveNames,
    repeat: Callable[[MotionPlan], MotionPlan] = lambda motion: motion,
) -> Loop:
    """Apply the shapers: along the path, then of the joints, then sampled ones as slaves of a loop without controllers.

    Args:
        motion: the planned motion.
        shapers: as for `make_loop`.
        names: names assigned so far.
        repeat: function that repeats the motion, for cycles or learning controllers; applied before the sampled shapers.

    Raises:
        InputError: something is of a kind that can't be a slave.
        TrajectoryError: a shaper can't act on this motion.
    """
    if not shapers:
        motion = repeat(motion)
        return Loop(motion, motion.joints)

    from flexfmu.cosim.control.shapers import Shaper
    from flexfmu.trajectories.shapers.sequence import ImpulseSequence

    # shapers that change the planned motion: along the path, then of the joints
    chosen = [Shaper(each) if isinstance(each, ImpulseSequence) else each for each in shapers]
    for place in ("path", "joints"):
        for each in chosen:
            if isinstance(each, Shaper) and each.apply == place:
                motion = APPLICATIONS[place](motion, each.sequence)
    motion = repeat(motion)
    # sampled shapers act in the loop; the motion includes their effect
    driving, inline_blocks = motion.joints, []
    for each in chosen:
        if not isinstance(each, Shaper):
            inline_blocks.append(inline_block(as_slave(each, names)))
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
