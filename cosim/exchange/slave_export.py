"""Export of a scene's slaves (planned motion, robot, controllers, shapers, imperfections) as FMUs, with the connections between
their variables."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.own_function import FunctionSlave
from flexfmu.cosim.control.imperfections.lag import Lag
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.sampled_slave import FmuTask, SampledFmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.recording import SlaveFacts, slave_facts
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import Loop, loop_of
from flexfmu.cosim.experiment.system import PLANT, scene_system
from flexfmu.fmu_build.archive import write_atomically
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.naming import Naming, namer
from flexfmu.fmu_build.toolchain import FmiVersion
from flexfmu.fmu_build.trajectory_build import Motion
from flexfmu.model.scene.schema import Scene


@dataclass(frozen=True)
class ExportedSlave:
    """A slave of a scene as an FMU.

    Attributes:
        facts: name in the system, description, sample time and offset.
        path: path of the FMU.
        parameters: start values that differ from those in the FMU.
    """

    facts: SlaveFacts
    path: Path
    parameters: Mapping[str, Value] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the slave in the system."""
        return self.facts.name


@dataclass(frozen=True)
class ExportedSystem:
    """The system of a scene as FMUs.

    Attributes:
        slaves: the planned motion (``trajectory``), the robot (``plant``), then controllers, shapers and imperfections.
        connections: pairs (``slave.output``, ``slave.input``) between exported slaves, with the variable names of the FMUs.
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
    naming: Naming = "structured",
    fmi: FmiVersion = "2",
    cache: bool = True,
    progress: ShowProgress = quiet,
) -> ExportedSystem:
    """Export the slaves of a scene as FMUs ``<folder>/<slave>.fmu``.

    Slaves from FMU files are copied unchanged; ``naming`` does not apply to them. The default experiment of the other FMUs ends at
    the stop time of the scene.

    Args:
        scene: the scene.
        folder: output folder, created if missing.
        names: names of the slaves to export; None for all.
        loop: controllers, shapers and imperfections as objects, instead of the scene's own.
        platforms: as for `flexfmu.fmu_build.build.build_fmu`.
        naming, fmi: as for `flexfmu.fmu_build.build.build_fmu`.
        cache: as for `flexfmu.fmu_build.build.build_fmu`.
        progress: called with the current activity and the finished fraction.

    Raises:
        InputError: no slave has such a name, or a slave can't be exported because it is a Python class of the user; no file is
            written then.
        TrajectoryError: the motion is not feasible, or can't be shaped.
        BuildError: an FMU can't be built or written.
    """
    # the same system as in a simulation
    loop = loop_of(scene) if loop is None else loop
    robot = build_scene(scene, cache=cache).path
    system = scene_system(scene, loop, robot)
    step = scene.cosimulation.communication_step
    chosen = _chosen(system.slaves, names, step)
    # an FMU for each slave
    options: dict[str, Any] = {
        "platforms": None if platforms is None else tuple(platforms),
        "naming": naming,
        "fmi": fmi,
        "cache": cache,
    }
    flat = namer(naming)

    def called(slave: Slave) -> Callable[[str], str]:
        return str if _is_copied(slave) else flat

    stop_time = float(f"{loop.motion.stop_time:.12g}")
    exported = []
    for number, facts in enumerate(slave_facts(chosen)):
        progress(f"exporting {facts.name}", number / len(chosen))
        path = folder / f"{facts.name}.fmu"
        # copied, or built with a default experiment that ends with the scene
        match slave := chosen[number]:
            case FmuSlave() | SampledFmu() | FmuTask() if _is_copied(slave):
                write_atomically(path, slave.path.read_bytes())
            case FmuSlave():
                build_scene(scene, output=path, **options)
            case BlockSlave():
                build_fmu(slave.block, path, stop_time=stop_time, **options)
            case TrajectorySlave():
                build_fmu(Motion(slave.trajectory), path, stop_time=stop_time, step=step, **options)
        values = slave.parameters if isinstance(slave, (FmuSlave, SampledFmu, FmuTask)) else {}
        if slave is system.plant:
            values = {**system.changes, **system.constants}
        exported.append(ExportedSlave(facts, path, {called(slave)(name): value for name, value in values.items()}))
    # connections between exported slaves, with the names of the variables in the FMUs
    ports = {
        f"{slave.name}.{each.name}": f"{slave.name}.{called(slave)(each.name)}"
        for slave in chosen
        for each in slave.variables
    }
    connections = ((ports.get(source), ports.get(target)) for source, target in system.wiring.connections)
    joined = tuple((source, target) for source, target in connections if source is not None and target is not None)
    return ExportedSystem(tuple(exported), joined, step, stop_time)


def _is_copied(slave: Slave) -> bool:
    """Whether the slave comes from an FMU file of the user, whose FMU is copied; the robot's is built."""
    return isinstance(slave, (FmuSlave, SampledFmu, FmuTask)) and slave.name != PLANT


def _chosen(slaves: Sequence[Slave], names: Collection[str] | None, step: float) -> tuple[Slave, ...]:
    """Return the named slaves in the system's order, continuous lags sampled for the communication step [s].

    Raises:
        InputError: no slave has such a name, or a slave is a Python class of the user.
    """
    known = [slave.name for slave in slaves]
    for name in names or ():
        if name not in known:
            raise InputError(f"there is no slave {name!r} in this scene; slaves: {', '.join(known)}")
    chosen = []
    for slave in slaves:
        if names and slave.name not in names:
            continue
        # a continuous lag is exported as a sampled one with many samples per time constant
        exported = BlockSlave(slave.sampled(step), slave.name) if isinstance(slave, Lag) else slave
        # only symbolic equations can be compiled to C
        if not isinstance(exported, (FmuSlave, SampledFmu, FmuTask, BlockSlave, TrajectorySlave)):
            if isinstance(exported, FunctionSlave):
                raise InputError(
                    f"slave {slave.name!r} can't be exported as an FMU. {exported.reason}. Write it with operations that CasADi knows "
                    "(casadi.if_else in place of if, no float), or name the other slaves to export"
                )
            raise InputError(
                f"slave {slave.name!r} is a {type(slave).__name__} in Python and can't be exported as an FMU; make it a "
                "function with @flexfmu.controller, a SymbolicBlock (flexfmu.model.symbolic) or a python-control system, or name the other slaves to export"
            )
        chosen.append(exported)
    return tuple(chosen)
