"""Export of a scene as an SSP file: all slaves as FMUs, their connections, parameters and default experiment."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from importlib.metadata import version
from os import PathLike
from pathlib import Path

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
    ssd_xml,
    ssv_xml,
)
from flexfmu.cosim.exchange.ssp.wiring import ComponentFmu
from flexfmu.cosim.experiment.parameters import scene_with_parameters
from flexfmu.cosim.experiment.scene_loop import Loop, loop_of
from flexfmu.fmu_build.archive import pack, write_atomically
from flexfmu.fmu_build.temporary import temporary_folder
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
    `flexfmu.cosim.many.prepared_scene.run_scene`. The same scene gives the same bytes.

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
    # the FMU has the parameters of the loop even if an importer ignores the parameter set; for a torque-driven robot without
    # controllers the torques that hold its start pose follow from the scene's parameters
    holds = scene.cosimulation.drive == "torque" and not loop.controllers
    robot = scene if holds else scene_with_parameters(scene, loop.parameters)
    # build all FMUs, then describe the system from their descriptions
    with temporary_folder("export") as folder:
        system = export_slaves(robot, Path(folder), loop=loop, platforms=platforms, cache=cache, progress=progress)
        files = {_source(slave): slave.path.read_bytes() for slave in system.slaves}
        structure = describe(scene.name, system)
    # the parameter set beside them, and one archive with reproducible bytes
    for binding in structure.bindings:
        files[PARAMETERS] = ssv_xml(binding.values, TOOL)
    write_atomically(target, pack({**files, DESCRIPTION: ssd_xml(structure, TOOL)}))
    return target


def describe(name: str, system: ExportedSystem) -> Structure:
    """Return the system structure of exported slaves.

    Args:
        name: name of the system.
        system: the slaves and their connections.
    """
    # both ends are ``slave.variable``
    ends = ([end.partition(".")[::2] for end in pair] for pair in system.connections)
    connections = tuple(SspConnection(source, target) for source, target in ends)
    fed = {each.end for each in connections}
    components: list[Component] = []
    parameters: list[SspParameter] = []
    known: dict[str, SspUnit] = {}
    tolerances: list[float] = []
    for slave in system.slaves:
        fmu = open_fmu(slave.path)
        owner = ComponentFmu(Component(slave.name, _source(slave), ()), fmu)
        known |= owner.units
        # units by their names, where the FMU defines them
        defined = {each: owner.unit(each) for each in owner.variables}
        units = {each: unit.name for each, unit in defined.items() if isinstance(unit, SspUnit)}
        # all outputs, and the connected inputs
        shown = (
            Connector(each.name, each.causality, each.type, units.get(each.name))
            for each in owner.variables.values()
            if each.causality == "output" or (slave.name, each.name) in fed
        )
        # sample time and offset, unless the FMU states them
        facts, times = slave.facts, None
        if facts.sample_time is not None:
            times = facts.sample_time, facts.offset or 0.0
        stated = fmu.sampling is not None or (fmu.fixed_step, 0.0) == times
        components.append(
            replace(
                owner.component,
                connectors=tuple(shown),
                description=facts.description,
                sampling=None if stated else times,
            )
        )
        # Real parameters with the FMU's start values, then the values of the scene, each in its variable's type
        values: dict[str, Value] = {
            each.name: float(each.start)
            for each in owner.variables.values()
            if each.causality == "parameter" and each.type == "Real" and each.start is not None
        }
        for variable, value in {**values, **slave.parameters}.items():
            kind = owner.variables[variable].type
            value = typed(owner.variables[variable], value) if kind == "Integer" else value
            value = float(value) if kind == "Real" else value
            parameters.append(SspParameter(f"{slave.name}.{variable}", kind, value, units.get(variable)))
        if (default := fmu.description.defaultExperiment) is not None and default.tolerance:
            tolerances.append(float(default.tolerance))

    def used(names: Iterable[str | None]) -> tuple[SspUnit, ...]:
        return tuple(known[each] for each in sorted({each for each in names if each is not None}))

    # one parameter set for the whole system, with hierarchical names
    found = ParameterSet(f"{name} parameters", tuple(parameters), used(each.unit for each in parameters))
    # an identifier, as OMSimulator requires
    identifier = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return Structure(
        name=f"_{identifier}" if identifier[:1].isdigit() else identifier,
        components=tuple(components),
        connections=connections,
        bindings=(Binding(found, source=PARAMETERS),) if parameters else (),
        units=used(each.unit for component in components for each in component.connectors),
        start=0.0,
        stop=system.stop_time,
        step=system.step,
        tolerance=min(tolerances, default=None),
        description=f"Scene {name}: a flexible five-bar robot with its motion and what stands between them.",
    )


def _source(slave: ExportedSlave) -> str:
    """Return the path of the slave's FMU within the archive."""
    return f"resources/{slave.name}.fmu"
