"""Every slave of a scene as an FMU (planned motion, robot, controllers, shapers and imperfections), and the connections between them by
the FMUs' variable names."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.imperfections.lag import Lag
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.sampled_slave import FmuTask, SampledFmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.recording import SlaveFacts, slave_facts
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.system import PLANT, SceneSystem, scene_system
from flexfmu.fmu_build.archive import write_atomically
from flexfmu.fmu_build.block_build import build_block_fmu
from flexfmu.fmu_build.naming import namer
from flexfmu.fmu_build.trajectory_build import build_trajectory_fmu

if TYPE_CHECKING:
    from flexfmu.cosim.experiment.loop import Loop
    from flexfmu.fmu_build.naming import Naming
    from flexfmu.model.scene.schema import Scene


@dataclass(frozen=True)
class ExportedSlave:
    """A slave of a scene as an FMU.

    Attributes:
        facts: its name in the system, what it is, its sample time and offset.
        path: the FMU.
        parameters: start values that differ from those in the FMU.
    """

    facts: SlaveFacts
    path: Path
    parameters: Mapping[str, Value] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its name in the system."""
        return self.facts.name


@dataclass(frozen=True)
class ExportedSystem:
    """All of a scene as FMUs.

    Attributes:
        slaves: the planned motion (``trajectory``), the robot (``plant``), then controllers, shapers and imperfections.
        connections: pairs (``slave.output``, ``slave.input``), between exported slaves alone, named as in the FMUs.
        step, stop_time: communication step and end of the simulation [s].
    """

    slaves: tuple[ExportedSlave, ...]
    connections: tuple[tuple[str, str], ...]
    step: float
    stop_time: float

    def named(self, naming: Naming, slaves: Collection[str]) -> ExportedSystem:
        """The same system with the variables of these slaves in another naming.

        Raises:
            ModelError: a variable has no flat name.
        """
        name = namer(naming)

        def port(end: str) -> str:
            slave, _, variable = end.partition(".")
            return f"{slave}.{name(variable)}" if slave in slaves else end

        def renamed(slave: ExportedSlave) -> ExportedSlave:
            starts = {name(key): value for key, value in slave.parameters.items()}
            return replace(slave, parameters=starts) if slave.name in slaves else slave

        connections = tuple((port(source), port(target)) for source, target in self.connections)
        return replace(self, slaves=tuple(map(renamed, self.slaves)), connections=connections)


ExportProgress = Callable[[str, float | None], None]
"""Called with what is being built and the finished fraction, 0..1."""


def export_slaves(
    scene: Scene,
    folder: Path,
    *,
    names: Collection[str] | None = None,
    loop: Loop | None = None,
    platforms: Iterable[str] | None = None,
    naming: Naming = "structured",
    cache: bool = True,
    progress: ExportProgress = lambda text, fraction: None,
) -> ExportedSystem:
    """Build the FMUs of a scene's slaves, ``<folder>/<slave>.fmu``.

    Slaves that come from FMU files are copied as they are, whatever the naming. The FMUs' default experiments last as long as
    the scene.

    Args:
        scene: the scene.
        folder: where the FMUs go; made if it is missing.
        names: slaves to export; None for all.
        loop: what stands between motion and robot, instead of the scene's own sections.
        platforms, naming, cache: as for `flexfmu.fmu_build.build.build_fmu`.
        progress: called with what is being built and the finished fraction.

    Raises:
        InputError: there is no slave of a name, or one can't be exported since it is a Python class of the user; nothing has
            been written then.
        TrajectoryError: the motion is not feasible, or can't be shaped.
        BuildError: an FMU can't be built or written.
    """
    # the system as it would be simulated
    loop = loop_of(scene) if loop is None else loop
    robot = build_scene(scene, cache=cache).path
    system = scene_system(scene, loop, robot)
    step = scene.cosimulation.step
    chosen = _chosen(system.slaves, names, step)
    # an FMU for each slave
    options = BuildOptions(platforms=None if platforms is None else tuple(platforms), naming=naming, cache=cache)
    export = _Exporter(scene, float(f"{loop.motion.stop_time:.12g}"), options)
    exported = []
    for number, facts in enumerate(slave_facts(chosen)):
        progress(f"exporting {facts.name}", number / len(chosen))
        path = folder / f"{facts.name}.fmu"
        export.write(chosen[number], path)
        exported.append(ExportedSlave(facts, path, _start_values(chosen[number], system)))
    # connections between exported slaves, by the names of their variables
    there = {slave.name for slave in chosen}
    connections = tuple(
        ends for ends in system.wiring.connections if all(end.partition(".")[0] in there for end in ends)
    )
    whole = ExportedSystem(tuple(exported), connections, step, export.stop_time)
    return whole.named(naming, {slave.name for slave in chosen if not _is_copied(slave)})


@dataclass(frozen=True)
class _Exporter:
    """Writes the FMU of one slave after the other."""

    scene: Scene
    stop_time: float
    options: BuildOptions

    def write(self, slave: Slave, path: Path) -> None:
        """Build or copy the slave's FMU."""
        scene, options = self.scene, self.options
        match slave:
            case FmuSlave() | SampledFmu() | FmuTask() if _is_copied(slave):
                write_atomically(path, slave.path.read_bytes())
            case FmuSlave():
                build_scene(scene, output=path, **options)
            case BlockSlave():
                build_block_fmu(slave.block, path, stop_time=self.stop_time, **options)
            case TrajectorySlave():
                step = scene.cosimulation.step
                build_trajectory_fmu(slave.trajectory, path, stop_time=self.stop_time, step=step, **options)


class BuildOptions(TypedDict):
    """How FMUs are built."""

    platforms: tuple[str, ...] | None
    naming: Naming
    cache: bool


def _is_copied(slave: Slave) -> bool:
    """Whether the slave has come from an FMU file: any but the robot."""
    return isinstance(slave, (FmuSlave, SampledFmu, FmuTask)) and slave.name != PLANT


def _chosen(slaves: Sequence[Slave], names: Collection[str] | None, step: float) -> tuple[Slave, ...]:
    """The slaves of these names, in the system's order; a continuous lag becomes a sampled one for the communication step [s].

    Raises:
        InputError: there is no slave of a name, or one is a Python class of the user.
    """
    known = [slave.name for slave in slaves]
    for name in names or ():
        if name not in known:
            raise InputError(f"there is no slave {name!r} in this scene; slaves: {', '.join(known)}")
    chosen = []
    for slave in slaves:
        if names and slave.name not in names:
            continue
        # a lag in continuous time is exported as one with many samples in its time constant
        exported = BlockSlave(slave.sampled(step), slave.name) if isinstance(slave, Lag) else slave
        # only equations become C
        if not isinstance(exported, (FmuSlave, SampledFmu, FmuTask, BlockSlave, TrajectorySlave)):
            raise InputError(
                f"slave {slave.name!r} is a {type(slave).__name__} in Python and can't be exported as an FMU; make it a "
                "SymbolicBlock (flexfmu.model.block) or a python-control system, or name the other slaves to export"
            )
        chosen.append(exported)
    return tuple(chosen)


def _start_values(slave: Slave, system: SceneSystem) -> Mapping[str, Value]:
    """Start values that differ from those in the slave's FMU."""
    if slave is system.plant:
        return {**system.changes, **system.constants}
    return slave.parameters if isinstance(slave, (FmuSlave, SampledFmu, FmuTask)) else {}
