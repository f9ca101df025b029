"""What stands between the planned motion and the robot: controllers, shapers and imperfections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from flexfmu.cosim.errors import InputError
from flexfmu.cosim.loop.slaves import Names, as_slave
from flexfmu.cosim.loop.wiring import Insert, passing
from flexfmu.cosim.planning import MotionPlan
from flexfmu.cosim.slave import Slave
from flexfmu.trajectories.trajectory import Trajectory

if TYPE_CHECKING:
    from flexfmu.trajectories.shapers.sequence import ImpulseSequence


@dataclass(frozen=True)
class Shaper:
    """An impulse sequence and where it acts.

    Attributes:
        sequence: the impulses.
        apply: ``joints`` (the joint references), ``path`` (the motion along the path, which keeps the path), or
            ``sampled`` (a slave that shapes the sampled joint references).
        sample_time: [s] of a sampled shaper; None for the others.
        offset: its first sample [s].
        name: name of its slave.

    Raises:
        InputError: a sampled shaper has no sample time, or another one has.
    """

    sequence: ImpulseSequence
    apply: str = "joints"
    sample_time: float | None = None
    offset: float = 0.0
    name: str = "shaper"

    def __post_init__(self) -> None:
        if self.apply not in ("joints", "path", "sampled"):
            raise InputError(f"a shaper acts on joints, path or sampled references, got {self.apply!r}")
        if (self.apply == "sampled") != (self.sample_time is not None):
            raise InputError(
                f"sample_time [s] goes with apply='sampled' alone, got {self.sample_time} s, {self.apply!r}"
            )


@dataclass(frozen=True)
class PayloadError:
    """The robot carries (1 + relative) times the scene's payload, and nothing else knows of it."""

    relative: float


@dataclass(frozen=True)
class Loop:
    """What stands between the planned motion and the robot.

    Attributes:
        motion: the planned motion, shapers included: what a perfect controller would make of it.
        driving: joint trajectory that is streamed; that of the motion but for sampled shapers.
        controllers: slaves that put out torques (or whatever the robot takes).
        inserts: slaves that signals pass.
        connect: ``slave.input`` → source, beyond equal names.
        parameters: parameters of the robot that differ from the scene's.
    """

    motion: MotionPlan
    driving: Trajectory
    controllers: tuple[Slave, ...] = ()
    inserts: tuple[Insert, ...] = ()
    connect: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Course:
    """A motion with its shapers.

    Attributes:
        motion: with all shapers.
        driving: joint trajectory that is streamed; that of the motion but for sampled shapers.
        inserts: the sampled shapers, and others that are slaves.
    """

    motion: MotionPlan
    driving: Trajectory
    inserts: tuple[Insert, ...] = ()


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
    names = Names()
    return close_loop(shape(motion, list(shapers), names), controllers, imperfections, connect or {}, names)


def close_loop(
    course: Course, controllers: Iterable[Any], imperfections: Iterable[Any], connect: Mapping[str, str], names: Names
) -> Loop:
    """A loop about a motion whose shapers have acted; otherwise as `make_loop`.

    Args:
        course: the motion with its shapers.
        controllers, imperfections, connect: as for `make_loop`.
        names: names given so far.
    """
    acting = tuple(as_slave(each, names) for each in controllers)
    inserts, parameters = list(course.inserts), dict[str, float]()
    for each in imperfections:
        if isinstance(each, PayloadError):
            parameters |= _payload(course.motion, each)
        else:
            inserts.append(passing(as_slave(each, names)))
    return Loop(course.motion, course.driving, acting, tuple(inserts), dict(connect), parameters)


def shape(
    motion: MotionPlan,
    shapers: Sequence[Any],
    names: Names,
    repeat: Callable[[MotionPlan], MotionPlan] = lambda motion: motion,
) -> Course:
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
        return Course(motion, motion.joints)
    from flexfmu.cosim.shaping.plan import APPLICATIONS
    from flexfmu.trajectories.shapers.sequence import ImpulseSequence

    chosen = [Shaper(each) if isinstance(each, ImpulseSequence) else each for each in shapers]
    for place in ("path", "joints"):
        for each in chosen:
            if isinstance(each, Shaper) and each.apply == place:
                motion = APPLICATIONS[place](motion, each.sequence)
    motion = repeat(motion)
    driving, inserts = motion.joints, []
    for each in chosen:
        if not isinstance(each, Shaper):
            inserts.append(passing(as_slave(each, names)))
        elif each.sample_time is not None:
            inserts.append(_sampled_shaper(each, each.sample_time, names))
            motion = _shaped_on_the_way(motion, each.sequence.split(each.sample_time))
    return Course(motion, driving, tuple(inserts))


def _sampled_shaper(shaper: Shaper, sample_time: float, names: Names) -> Insert:
    """The slave of a sampled shaper."""
    from flexfmu.cosim.shaping.block import shaper_block

    block = shaper_block(shaper.sequence, sample_time, offset=shaper.offset, name=shaper.name)
    return passing(as_slave(block, names))


def _shaped_on_the_way(motion: MotionPlan, sequence: ImpulseSequence) -> MotionPlan:
    """The motion that a sampled shaper makes of the streamed one, in all its repetitions."""
    from flexfmu.cosim.shaping.plan import shape_joints

    shaped = shape_joints(motion, sequence)
    if motion.repetition is None:
        return shaped
    return replace(shaped, repetition=replace(motion.repetition, once=shape_joints(motion.once, sequence)))


def _payload(motion: MotionPlan, error: PayloadError) -> Mapping[str, float]:
    """The payload that the robot carries."""
    from flexfmu.cosim.imperfections.payload_error import with_payload_error

    return {"payload.mass": with_payload_error(motion.scene, error.relative).payload.mass}
