"""The loop around the robot: planned motion, controllers, shapers, imperfections and disturbances, from the sections of a scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from flexfmu.cosim.engine.errors import InputError, WiringError
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.slave import Sampled, Slave, offset
from flexfmu.cosim.experiment.parameters import holding_torques, scene_parameters, scene_values
from flexfmu.cosim.experiment.planning import APPLICATIONS, MotionPlan, plan, plan_own, shape_joints
from flexfmu.cosim.experiment.user_slaves import SlaveNames, as_slave, from_source
from flexfmu.cosim.experiment.wiring import OPTIONAL, InlineBlock, inline_block, names_of
from flexfmu.model.scene.controllers import FrictionCompensationSection, LearningSection
from flexfmu.model.scene.imperfections import ParameterErrorSection, PayloadErrorSection
from flexfmu.model.scene.loop import FmuSection, ObjectSection, PythonSection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory

if TYPE_CHECKING:
    from flexfmu.cosim.control.shapers import Shaper
    from flexfmu.trajectories.sources import OwnMotion


WHOLE = ("feedforward", "computed-torque")
"""Kinds of controllers whose torques are those of the whole rigid robot."""


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


def loop_of(
    scene: Scene,
    motion: MotionPlan | None = None,
    own: MotionPlan | None = None,
    *,
    about_rest: bool = False,
    probes: bool = False,
) -> Loop:
    """Build the loop of a scene.

    Args:
        scene: the scene.
        motion: motion instead of the scene's own with its shapers and cycles.
        own: motion in place of that along the scene's path, to which shapers and cycles apply.
        about_rest: whether the loop is for small motions about standstill: controllers compensate no Coulomb friction, and none
            learns from cycle to cycle.
        probes: whether controllers that learn stay in a loop about standstill, as integrators of a single sample.

    Raises:
        InputError: a slave can't be made or connected.
        TrajectoryError: the motion is not feasible, or can't be shaped.
    """
    shapers = scene.shaper if motion is None else ()
    planned = motion or own or plan(scene)
    # the scene's own motion has its cycles, a given one is what runs
    with_cycles = motion is None and scene.trajectory.way_back != "none"
    if not (scene.controller or shapers or scene.imperfection or scene.filter or scene.disturbance or with_cycles):
        return Loop(planned, planned.joints)
    names = SlaveNames()
    builder = _Builder(scene, planned, names, about_rest)
    # in this order: controllers need the shaped, repeated motion; imperfections the controllers' sample time
    shaped = _shaped(planned, [builder.shaper(each) for each in shapers], names, partial(_repeated, scene, with_cycles))
    sections = [each for each in scene.controller if probes or not (about_rest and isinstance(each, LearningSection))]
    controllers = [slave for each in sections for slave in builder.slaves(each, shaped.motion)]
    # torques are filtered before they meet imperfections, measurements and references after that
    before = [each for each in scene.filter if each.signal == "torque"]
    after = [each for each in scene.filter if each.signal != "torque"]
    of_robot = PayloadErrorSection | ParameterErrorSection
    signals = [each for each in (*before, *scene.imperfection, *after) if not isinstance(each, of_robot)]
    inline_blocks = [inline_block(builder.imperfection(each, controllers)) for each in signals]
    disturbances = [builder.disturbance(each, shaped.motion.stop_time) for each in scene.disturbance]
    if disturbances:
        from flexfmu.cosim.control.disturbances import with_sums

        disturbances = with_sums(disturbances, names.unused)
    return replace(
        shaped,
        controllers=_with_sum(controllers, builder.connect, names),
        inline_blocks=(*shaped.inline_blocks, *inline_blocks),
        connect=builder.connect,
        parameters=_real_parameters(scene),
        disturbances=tuple(disturbances),
    )


def own_loop(scene: Scene, own: OwnMotion | Trajectory) -> Loop:
    """Return the loop of a scene with an own motion, to which its shapers and cycles apply.

    Raises:
        InputError: the scene leaves the choice of effects open, or a slave can't be made or connected.
        TrajectoryError, SceneError: as for `plan_own`.
    """
    if scene.effects.select is not None:
        raise InputError(
            f'scene {scene.name} has `select = "auto"`, which chooses the effects for the scene\'s own path: name the effects '
            "for an own motion, for example those that `flexfmu effects` prints"
        )
    planned = plan_own(scene, own)
    return loop_of(planned.scene, own=planned)


def _shaped(
    motion: MotionPlan, shapers: Sequence[Shaper | Slave], names: SlaveNames, repeat: Callable[[MotionPlan], MotionPlan]
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


def _with_sum(controllers: Sequence[Slave], connect: Mapping[str, str], names: SlaveNames) -> tuple[Slave, ...]:
    """The controllers, and the sum of the feedforwards that several of them output.

    Args:
        controllers: the controllers.
        connect: ``slave.input`` → source; inputs that have a source here don't take the sum.
        names: assigns unique names.

    Raises:
        WiringError: the controllers that take the sum aren't sampled, or not at the same instants.
    """
    sources: dict[str, list[str]] = {}
    for each in controllers:
        for name in names_of(each, "output"):
            if name.endswith(OPTIONAL):
                sources.setdefault(name, []).append(each.name)
    several = {name: owners for name, owners in sources.items() if len(owners) > 1}
    takers = [
        each
        for each in controllers
        for name in names_of(each, "input")
        if name in several and f"{each.name}.{name}" not in connect
    ]
    if not takers:
        return tuple(controllers)
    # one clock, at whose instants the sum is up to date
    clocks = {(each.sample_time, offset(each)) if isinstance(each, Sampled) else None for each in takers}
    clock = clocks.pop()
    if clocks or clock is None:
        signal, owners = next(iter(several.items()))
        raise WiringError(
            f"{' and '.join(owners)} all output {signal}, but {', '.join(dict.fromkeys(each.name for each in takers))}, "
            "which take the sum, aren't sampled at the same instants: give them one sample_time and offset [s], or connect "
            f'one of them, connect = {{ "{signal}" = "{owners[0]}.{signal}" }} for example'
        )
    from flexfmu.cosim.control.blocks.slave import BlockSlave
    from flexfmu.cosim.control.disturbances import sum_block

    name, (period, first) = names.unused("feedforward_sum"), clock
    block = sum_block(name, "Sum of feedforward torques", several, sample_time=period, offset=first)
    return (*controllers, BlockSlave(block))


def _real_parameters(scene: Scene) -> dict[str, float]:
    """The parameters of the robot that really are others than planning, controllers and shapers assume.

    Raises:
        InputError: the scene has no payload of which there could be an error, or a key isn't one of the robot.
        SceneError: a value is out of range.
    """
    real, known = scene, {each.key for each in scene_values(scene).values()}
    for each in scene.imperfection:
        if isinstance(each, PayloadErrorSection):
            from flexfmu.cosim.control.sections import with_payload_error

            real = with_payload_error(real, each.relative)
        elif isinstance(each, ParameterErrorSection):
            if wrong := [key for key in each.parameters if key.partition("[")[0] not in known]:
                raise InputError(
                    f"`imperfection.parameters` has {wrong[0]}, which is no number of the robot: name keys such as payload.mass or "
                    "mechanism.material.density"
                )
            real = real.replace(dict(each.parameters))
    assumed = scene_parameters(scene)
    return {name: value for name, value in scene_parameters(real).items() if value != assumed.get(name)}


def _repeated(scene: Scene, with_cycles: bool, motion: MotionPlan) -> MotionPlan:
    """The motion, repeated if a controller learns, or with the scene's cycles.

    Raises:
        InputError: controllers learn over different numbers of cycles, or at different sample times.
    """
    if with_cycles:
        from flexfmu.cosim.experiment.cycles import in_cycles

        return in_cycles(motion)
    learning = scene.learners
    if not learning or motion.repetition is not None:
        return motion
    first = learning[0]
    # controllers that learn together need the same cycles and samples
    for key in ("cycles", "sample_time"):
        values = [getattr(each, key) for each in learning]
        if len(set(values)) > 1:
            raise InputError(
                f"all learning controllers of a scene share one motion: give them the same `{key}`, got {values}"
            )
    from flexfmu.cosim.experiment.cycles import repeated

    return repeated(motion, first.cycles, first.sample_time)


class _Builder:
    """Builds shapers, imperfections and slaves from a scene's sections; errors as for `loop_of`.

    Args:
        scene: the scene.
        planned: its planned motion, before shapers.
        names: assigns unique names.
        about_rest: see `loop_of`.

    Attributes:
        connect: ``slave.input`` → source, from the sections built so far.
    """

    def __init__(self, scene: Scene, planned: MotionPlan, names: SlaveNames, about_rest: bool) -> None:
        self._scene, self._planned, self._names, self._about_rest = scene, planned, names, about_rest
        self._holding_torques: Sequence[float] | None = None
        self.connect: dict[str, str] = {}

    def shaper(self, section: Any) -> Shaper | Slave:
        """The shaper of a section."""
        if isinstance(section, (PythonSection, FmuSection)):
            return self.slave(section, self._planned)
        if isinstance(section, ObjectSection):
            return _given_shaper(section) or self.slave(section, self._planned)
        shaper: Shaper = self._built(section, self._planned, "", 0.0)
        return shaper

    def imperfection(self, section: Any, controllers: Sequence[Slave]) -> Slave:
        """The imperfection or filter of a section; its default sample time is that of the first sampled controller.

        Of a cascade it is that of the loop that exchanges the signal; encoders count as velocities.
        """
        for key in ("time", "longest"):
            delay = getattr(section, key, None) or 0.0
            if delay >= (end := self._planned.stop_time):
                raise InputError(
                    f"a {section.kind} of {delay:g} s is longer than the run, {end:g} s: give its `{key}` in s, 0.002 for 2 ms"
                )
        sample_time = _rate(getattr(section, "signal", "velocity"), controllers)
        sample_time = sample_time or self._scene.cosimulation.communication_step
        return self.slave(section, self._planned, sample_time)

    def disturbance(self, section: Any, stop_time: float) -> Slave:
        """The disturbance of a section; its default sample time is the communication step.

        Raises:
            InputError: it begins when the run ends [s], or later.
        """
        name = self._names.chosen(section.name, f"{section.kind}_disturbance")
        if section.begin >= stop_time:
            raise InputError(
                f"{name} begins at {section.begin:g} s, but the run ends at {stop_time:g} s: let it begin earlier, or give the "
                f"motion a longer `trajectory.dwell`"
            )
        slave: Slave = self._built(section, self._planned, name, self._scene.cosimulation.communication_step)
        return slave

    def slave(self, section: Any, motion: MotionPlan, sample_time: float = 0.0) -> Slave:
        """The only slave of a section; arguments as for `slaves`."""
        (slave,) = self.slaves(section, motion, sample_time)
        return slave

    def slaves(self, section: Any, motion: MotionPlan, sample_time: float = 0.0) -> tuple[Slave, ...]:
        """The slaves of a section, named, with their connections in ``connect``.

        Args:
            section: the section.
            motion: motion for the section's builder.
            sample_time: default sample time [s].
        """
        made: Slave | tuple[Slave, ...]
        if isinstance(section, PythonSection):
            source = from_source(section.source, section.arguments, section.folder)
            made = as_slave(source, self._names, section.name)
        elif isinstance(section, ObjectSection):
            own = section.object.value
            made = as_slave(own.changed(section.arguments) if section.arguments else own, self._names, section.name)
        elif isinstance(section, FmuSection):
            made = fmu_slave(
                section.path,
                self._names.of_file(section.path, section.name),
                section.parameters,
                sample_time=section.sample_time,
                offset=section.offset,
                output_order=section.output_order,
            )
        else:
            # the name first: it seeds random numbers
            name = self._names.chosen(section.name, section.kind.replace("-", "_"))
            made = self._built(section, motion, name, sample_time)
        slaves = made if isinstance(made, tuple) else (made,)
        if len(slaves) > 1:
            for slave in slaves:
                self._names.chosen(slave.name, slave.name)
        # targets without the name of another slave are inputs of this section's slaves, the first one's if misspelt
        own = {name: slave.name for slave in reversed(slaves) for name in names_of(slave, "input")}
        heads = {head for name in own if (head := name.partition(".")[0]) not in self._names}
        for target, source in section.connect.items():
            head, dot, _ = target.partition(".")
            is_own = target in own or not dot or head in heads
            self.connect[f"{own.get(target, slaves[0].name)}.{target}" if is_own else target] = source
        return slaves

    def _built(self, section: Any, motion: MotionPlan, name: str, sample_time: float) -> Any:
        """What a section of a kind of our own describes."""
        from flexfmu.cosim.control.sections import LoopContext, build

        period = None if motion.repetition is None else motion.repetition.period
        assumed, planned = motion.scene.model_copy(update={"disturbance": ()}), self._planned.joints
        if is_about_rest := self._about_rest:
            from flexfmu.model.linear import without_coulomb_friction  # needs CasADi, which other runs do without

            assumed = without_coulomb_friction(assumed)
            if isinstance(section, FrictionCompensationSection):
                section = section.model_copy(update={"coulomb": (0.0, 0.0)})
        motions = motion.along_path, planned, motion.joints
        return build(section, LoopContext(assumed, *motions, period, name, sample_time, self._before, is_about_rest))

    def _before(self, kind: str) -> Sequence[float]:
        """Values of a signal of both joints before the start, at rest; no torques for a robot driven by motion."""
        if kind == "position":
            return tuple(float(angle) for angle in self._planned.joints.evaluate(0.0, 0, "left")[0, 0])
        if kind != "torque":
            return (0.0, 0.0)
        if self._holding_torques is None:
            self._holding_torques = tuple(holding_torques(self._scene).values())
        return self._holding_torques


def _given_shaper(section: ObjectSection) -> Shaper | None:
    """The shaper that an object is, an impulse sequence being one of the joint references; None for a slave."""
    from flexfmu.cosim.control.shapers import Shaper
    from flexfmu.trajectories.shapers.sequence import ImpulseSequence

    value = section.object.value
    if isinstance(value, ImpulseSequence):
        return Shaper(value)
    return value if isinstance(value, Shaper) else None


def _rate(signal: str, controllers: Sequence[Slave]) -> float:
    """Sample time [s] of the first sampled controller, or of the loop of a cascade that exchanges a signal; 0 for none."""
    sampled = [each for each in controllers if isinstance(each, Sampled)]
    # the other loops of a cascade take commands
    loops = [each for k, each in enumerate(sampled) if k == 0 or any(".command." in v.name for v in each.variables)]
    name = "joint1.reference.position" if signal == "reference" else f"joint1.{signal}"
    exchanging = [each for each in loops if any(v.name == name for v in each.variables)]
    return next((each.sample_time for each in [*exchanging, *sampled]), 0.0)


def counted_twice(scene: Scene) -> list[str]:
    """Sentences about gravity and friction that several controllers of a scene compensate."""
    kinds = [each.kind for each in scene.controller]
    whole = [each for each in WHOLE if each in kinds]
    parts = {"all torques of the motion": whole}
    if any(scene.effects.gravity):
        parts["gravity"] = [*whole[:1], *(each for each in kinds if each == "gravity-feedforward")]
    if scene.effects.joint_friction.is_there:
        parts["friction"] = [*whole[:1], *(each for each in kinds if each == "friction-compensation")]
    return [
        f"{what} counts twice: `{found[0]}` has it, and so does `{found[1]}`; leave one of them out"
        for what, found in parts.items()
        if len(found) > 1
    ]
