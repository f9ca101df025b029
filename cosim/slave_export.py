"""Every slave of a scene as an FMU: planned motion, robot, controllers, shapers and imperfections, and how they are wired."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from flexfmu.cosim.block_slave import BlockSlave
from flexfmu.cosim.errors import InputError
from flexfmu.cosim.fmu_slave import FmuSlave
from flexfmu.cosim.fmu_variables import Value
from flexfmu.cosim.loop_recording import SlaveFacts, slave_facts
from flexfmu.cosim.loop_sections import loop_of
from flexfmu.cosim.sampled_fmu import SampledFmu
from flexfmu.cosim.scene_system import PLANT, SceneSystem, scene_system
from flexfmu.cosim.slave import Slave
from flexfmu.cosim.trajectory_slave import TrajectorySlave
from flexfmu.fmu_build.archive import write_atomically
from flexfmu.fmu_build.block_build import build_block_fmu
from flexfmu.fmu_build.scene_build import build_scene
from flexfmu.fmu_build.trajectory_build import build_trajectory_fmu

if TYPE_CHECKING:
    from flexfmu.cosim.loop import Loop
    from flexfmu.model.scene import Scene

Progress = Callable[[str, float | None], None]
"""Is told what is being built and the finished fraction, 0..1."""


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
        connections: pairs (``slave.output``, ``slave.input``), between exported slaves alone.
        step, stop_time: communication step and end of the simulation [s].
    """

    slaves: tuple[ExportedSlave, ...]
    connections: tuple[tuple[str, str], ...]
    step: float
    stop_time: float


def export_slaves(
    scene: Scene,
    folder: Path,
    *,
    names: Collection[str] | None = None,
    loop: Loop | None = None,
    platforms: Iterable[str] | None = None,
    cache: bool = True,
    progress: Progress = lambda text, fraction: None,
) -> ExportedSystem:
    """Build the FMUs of a scene's slaves, ``<folder>/<slave>.fmu``.

    Slaves that come from FMU files are copied as they are. The FMUs' default experiments last as long as the scene.

    Args:
        scene: the scene.
        folder: where the FMUs go; made if it is missing.
        names: slaves to export; None for all.
        loop: what stands between motion and robot, instead of the scene's own sections.
        platforms, cache: as for `flexfmu.fmu_build.build.build_fmu`.
        progress: is told what is being built.

    Raises:
        InputError: there is no slave of a name, or one can't leave as an FMU since it is a Python class of the user's own;
            nothing has been written then.
        TrajectoryError: the motion is not feasible, or can't be shaped.
        BuildError: an FMU can't be built or written.
    """
    loop = loop_of(scene) if loop is None else loop
    robot = build_scene(scene, cache=cache).path
    system = scene_system(scene, loop, robot)
    chosen = _chosen(system.slaves, names)
    for slave in chosen:
        _check_exportable(slave)
    export = _Exporter(
        scene, float(f"{loop.motion.stop_time:.12g}"), None if platforms is None else tuple(platforms), cache
    )
    exported = []
    for number, facts in enumerate(slave_facts(chosen)):
        progress(f"exporting {facts.name}", number / len(chosen))
        path = folder / f"{facts.name}.fmu"
        export.write(chosen[number], path)
        exported.append(ExportedSlave(facts, path, _start_values(chosen[number], system)))
    connections = _between({facts.name for facts in slave_facts(chosen)}, system.wiring.connections)
    return ExportedSystem(tuple(exported), connections, scene.cosimulation.step, export.stop_time)


@dataclass(frozen=True)
class _Exporter:
    """Writes the FMU of one slave after the other."""

    scene: Scene
    stop_time: float
    platforms: tuple[str, ...] | None
    cache: bool

    def write(self, slave: Slave, path: Path) -> None:
        """Build or copy the slave's FMU."""
        scene, options = self.scene, _Options(platforms=self.platforms, cache=self.cache)
        match slave:
            case FmuSlave(name=name) if name == PLANT:
                build_scene(scene, output=path, **options)
            case FmuSlave() | SampledFmu():
                write_atomically(path, slave.path.read_bytes())
            case BlockSlave():
                build_block_fmu(slave.block, path, stop_time=self.stop_time, **options)
            case TrajectorySlave():
                step = scene.cosimulation.step
                build_trajectory_fmu(slave.trajectory, path, stop_time=self.stop_time, step=step, **options)


class _Options(TypedDict):
    """How FMUs are built."""

    platforms: tuple[str, ...] | None
    cache: bool


def _chosen(slaves: Sequence[Slave], names: Collection[str] | None) -> tuple[Slave, ...]:
    """The slaves of these names, in the system's order.

    Raises:
        InputError: there is no slave of a name.
    """
    known = [slave.name for slave in slaves]
    for name in names or ():
        if name not in known:
            raise InputError(f"there is no slave {name!r} in this scene; slaves: {', '.join(known)}")
    return tuple(slave for slave in slaves if not names or slave.name in names)


def _check_exportable(slave: Slave) -> None:
    """Only equations leave as C.

    Raises:
        InputError: the slave is a Python class of the user's own.
    """
    if not isinstance(slave, (FmuSlave, SampledFmu, BlockSlave, TrajectorySlave)):
        raise InputError(
            f"slave {slave.name!r} is a {type(slave).__name__} in Python and can't leave as an FMU; make it a SymbolicBlock "
            "(flexfmu.model.block) or a python-control system, or name the other slaves to export"
        )


def _start_values(slave: Slave, system: SceneSystem) -> Mapping[str, Value]:
    """Start values that the slave's FMU doesn't have of itself."""
    if slave is system.plant:
        return {**system.changes, **system.constants}
    return slave.parameters if isinstance(slave, (FmuSlave, SampledFmu)) else {}


def _between(names: Collection[str], connections: Iterable[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """The connections whose both ends are there."""
    return tuple(ends for ends in connections if all(end.partition(".")[0] in names for end in ends))
