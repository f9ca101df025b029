"""Export of a scene as an SSP file: all slaves as FMUs, their connections, parameters and default experiment."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.variables import Value, typed
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.exchange.slave_export import ExportedSlave, ExportedSystem, export_slaves
from flexfmu.cosim.exchange.ssp.archive import DESCRIPTION
from flexfmu.cosim.exchange.ssp.structure import (
    Binding,
    Component,
    Connector,
    ParameterSet,
    SspConnection,
    SspParameter,
    SspUnit,
    Structure,
)
from flexfmu.cosim.exchange.ssp.wiring import ComponentFmu
from flexfmu.cosim.exchange.ssp.xml import ssd_xml, ssv_xml
from flexfmu.cosim.experiment.parameters import scene_with_parameters
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.fmu_build.archive import pack, write_atomically

if TYPE_CHECKING:
    from flexfmu.cosim.experiment.loop import Loop
    from flexfmu.model.scene.schema import Scene

TOOL = f"flexfmu {version('flexfmu')}"

PARAMETERS = "resources/parameters.ssv"
"""File of the parameter set, with hierarchical names such as ``plant.payload.mass``."""


def export_ssp(
    scene: Scene,
    path: str | PathLike[str],
    *,
    loop: Loop | None = None,
    platforms: Iterable[str] | None = None,
    cache: bool = True,
    progress: ShowProgress = quiet,
) -> Path:
    """Export a scene as an SSP 1.0 file and return its path.

    Planned motion, robot, controllers, shapers and imperfections become FMUs in ``resources/``, connected as in
    `flexfmu.cosim.experiment.prepared_scene.run_scene`. The same scene gives the same bytes.

    Most importers exchange only values at the communication points: their results agree with `run_scene` to first order in the
    communication step. `flexfmu.cosim.exchange.ssp.loading.load_ssp` also passes derivatives, and agrees to the accuracy of the
    trajectory's FMU.

    Args:
        scene: the scene.
        path: file to write.
        loop: controllers, shapers and imperfections as objects, instead of the scene's own.
        platforms: FMI platforms of the FMUs' binaries; None for this machine's.
        cache: whether FMUs may be taken from the cache.
        progress: called with the current activity and the finished fraction.

    Raises:
        InputError: a slave can't be exported because it is a Python class of the user, or the slaves can't be connected.
        TrajectoryError: the motion is not feasible, or can't be shaped.
        BuildError: an FMU can't be built, or the file can't be written.
    """
    target = Path(path)
    loop = loop_of(scene) if loop is None else loop
    robot = _robot(scene, loop)
    # build all FMUs, then describe the system from their descriptions
    with tempfile.TemporaryDirectory(prefix="flexfmu-") as folder:
        system = export_slaves(robot, Path(folder), loop=loop, platforms=platforms, cache=cache, progress=progress)
        files = {_source(slave): slave.path.read_bytes() for slave in system.slaves}
        structure = describe(scene.name, system)
    # the parameter set beside them, and one archive with reproducible bytes
    for binding in structure.bindings:
        files[PARAMETERS] = ssv_xml(binding.values, TOOL)
    write_atomically(target, pack({**files, DESCRIPTION: ssd_xml(structure, TOOL)}))
    return target


def _robot(scene: Scene, loop: Loop) -> Scene:
    """Return the scene with the robot's parameters in ``loop``, so that the FMU has them even if an importer ignores the parameter set.

    A torque-driven robot without controllers is unchanged: the torques that hold its start pose follow from the scene's parameters.
    """
    holds = scene.cosimulation.drive == "torque" and not loop.controllers
    return scene if holds else scene_with_parameters(scene, loop.parameters)


def describe(name: str, system: ExportedSystem) -> Structure:
    """Return the system structure of exported slaves.

    Args:
        name: name of the system.
        system: the slaves and their connections.
    """
    # components with their connectors
    fmus = {slave.name: _fmu(slave, system.connections) for slave in system.slaves}
    parameters = [each for slave in system.slaves for each in _parameters(slave, fmus[slave.name])]
    connectors = [each for fmu in fmus.values() for each in fmu.component.connectors]
    # one parameter set for the whole system, with hierarchical names
    values = ParameterSet(f"{name} parameters", tuple(parameters), _units((each.unit for each in parameters), fmus))
    defaults = [fmu.fmu.description.defaultExperiment for fmu in fmus.values()]
    return Structure(
        name=_identifier(name),
        components=tuple(fmu.component for fmu in fmus.values()),
        connections=tuple(SspConnection(_ends(source), _ends(target)) for source, target in system.connections),
        bindings=(Binding(values, source=PARAMETERS),) if parameters else (),
        units=_units((each.unit for each in connectors), fmus),
        start=0.0,
        stop=system.stop_time,
        step=system.step,
        tolerance=min(
            (float(each.tolerance) for each in defaults if each is not None and each.tolerance), default=None
        ),
        description=f"Scene {name}: a flexible five-bar robot with its motion and what stands between them.",
    )


def _identifier(name: str) -> str:
    """Return the name as an identifier (letters, digits, underscores), as OMSimulator requires."""
    found = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{found}" if found[:1].isdigit() else found


def _fmu(slave: ExportedSlave, connections: Sequence[tuple[str, str]]) -> ComponentFmu:
    """Return the slave's component with connectors for all outputs and for the connected inputs."""
    fed = {_ends(target) for _, target in connections}
    fmu = open_fmu(slave.path)
    bare = ComponentFmu(Component(slave.name, _source(slave), ()), fmu)
    # all outputs, and the connected inputs
    shown = [
        Connector(each.name, each.causality, each.type, _unit_name(bare, each.name))
        for each in bare.variables.values()
        if each.causality == "output" or (slave.name, each.name) in fed
    ]
    # write sample time and offset unless the FMU states them
    facts = slave.facts
    times = None if facts.sample_time is None else (facts.sample_time, facts.offset or 0.0)
    stated = fmu.sampling is not None or (fmu.fixed_step, 0.0) == times
    component = Component(
        slave.name,
        _source(slave),
        tuple(shown),
        description=facts.description,
        sampling=None if stated else times,
    )
    return ComponentFmu(component, fmu)


def _parameters(slave: ExportedSlave, fmu: ComponentFmu) -> list[SspParameter]:
    """Return the values of all Real parameters, and of other variables whose start value differs from the FMU's."""
    # Real parameters with the FMU's start values, then the values of the scene
    started = {
        name: float(each.start)
        for name, each in fmu.variables.items()
        if each.causality == "parameter" and each.type == "Real" and each.start is not None
    }
    values: Mapping[str, Value] = {**started, **slave.parameters}
    # each value in its variable's type
    found = []
    for name, value in values.items():
        variable = fmu.variables[name]
        if variable.type == "Real":
            value = float(value)
        elif variable.type == "Integer":
            value = typed(variable, value)
        found.append(SspParameter(f"{slave.name}.{name}", variable.type, value, _unit_name(fmu, name)))
    return found


def _unit_name(fmu: ComponentFmu, name: str) -> str | None:
    """Return the name of a variable's unit; None if the FMU doesn't define it."""
    unit = fmu.unit(name)
    return unit.name if isinstance(unit, SspUnit) else None


def _units(names: Iterable[str | None], fmus: Mapping[str, ComponentFmu]) -> tuple[SspUnit, ...]:
    """Return the definitions of the units, sorted by name."""
    known = {name: unit for fmu in fmus.values() for name, unit in fmu.units.items()}
    return tuple(known[name] for name in sorted({name for name in names if name is not None}))


def _source(slave: ExportedSlave) -> str:
    """Return the path of the slave's FMU within the archive."""
    return f"resources/{slave.name}.fmu"


def _ends(full_name: str) -> tuple[str, str]:
    """Split ``slave.variable`` into both names."""
    slave, _, variable = full_name.partition(".")
    return slave, variable
