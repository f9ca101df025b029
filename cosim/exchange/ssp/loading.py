"""Loading of an SSP file as a system that can be simulated."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np

from flexfmu.cosim.engine.child_process import CALL_LIMIT
from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.master.couplings import Algorithm
from flexfmu.cosim.engine.master.iteration import Anderson, LoopSolver
from flexfmu.cosim.engine.master.simulator import Progress, Simulation, isolation, simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import IDENTITY, System, TableMap, connect
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.engine.trajectory_slave import REFERENCES as KINDS
from flexfmu.cosim.engine.trajectory_slave import FmuTrajectory, TrajectorySlave
from flexfmu.cosim.exchange.ssp.archive import DESCRIPTION, SspArchive, SspError
from flexfmu.cosim.exchange.ssp.structure import Component, Structure, Subsystem, levels, read_structure
from flexfmu.cosim.exchange.ssp.wiring import (
    ComponentFmu,
    Network,
    Origin,
    check_connectors,
    shown,
    start_values,
    wires,
)
from flexfmu.cosim.experiment.recording import held, plain_names
from flexfmu.cosim.experiment.system import PLANT, REFERENCES


@dataclass(frozen=True)
class SspSystem:
    """A system that an SSP file describes.

    Attributes:
        structure: content of the SSD.
        system: slaves and connections.
        start, stop: start and stop time [s].
        step: communication step [s].
        tolerance: relative tolerance of the FMUs; None for their own.
        ignored: parameters in the file that match no variable.
        names: full name of a component → name of its slave, without dots.
        shown: full name of a system's connector → origin of its signal.
        remarks: warnings about ignored parts of the file.
    """

    structure: Structure
    system: System
    start: float
    stop: float
    step: float
    ignored: tuple[str, ...]
    names: Mapping[str, str]
    shown: Mapping[str, Origin]
    tolerance: float | None = None
    remarks: tuple[str, ...] = ()

    def simulate(
        self,
        *,
        tolerance: float | None = None,
        progress: Progress | None = None,
        algorithm: Algorithm | None = None,
        step_control: StepDoubling | None = None,
        isolate: bool | None = None,
        call_limit: float = CALL_LIMIT,
    ) -> Simulation:
        """Simulate the system with `flexfmu.cosim.engine.master.simulator.simulate`.

        Signals have the names of the file: ``inner.first.x`` for a component in a subsystem, ``inner.y`` for a system's connector.
        Those of an exported scene have the names that they have in `flexfmu.cosim.many.prepared_scene.run_scene`, ``joint1.torque``
        for example; the recording finds them by their names in the file, ``plant.joint1.torque``, too.

        Args:
            tolerance: relative tolerance of the FMUs; None for the file's, or the FMUs' own if the file has none.
            progress, algorithm, step_control: as for `simulate`.
            isolate: whether to simulate in a child process; None: only with FMUs of other tools.
            call_limit: time limit of a single call of an FMU in the child process [s].

        Raises:
            InputError: the times are invalid, or a slave that needs rollback can't restore an earlier state.
        """
        simulation = simulate(
            self.system,
            self.stop,
            self.step,
            start=self.start,
            tolerance=self.tolerance if tolerance is None else tolerance,
            progress=progress,
            algorithm=algorithm,
            step_control=step_control,
            isolation=isolation(isolate, self.system.slaves, call_limit, caller_owned=False),
        )
        return replace(simulation, recording=self._renamed(simulation.recording))

    def _renamed(self, recording: Recording) -> Recording:
        """Return the recording with the names of the file, and with the signals of systems' connectors."""
        # names of slaves → names of components in the file
        owners = {slave: name for name, slave in self.names.items()}
        parts = {name: name.split(".", 1) for name in recording.columns}
        columns = {f"{owners[slave]}.{name}": recording.columns[full] for full, (slave, name) in parts.items()}
        # systems' connectors show the signal that reaches them
        for name, origin in self.shown.items():
            source = columns.get(".".join(origin.node))
            if source is not None:
                columns.setdefault(name, _mapped(source, origin))
        # an exported scene is our robot as ``plant``, led by our ``trajectory``
        slaves = {slave.name: slave for slave in self.system.slaves}
        plant, led = slaves.get(PLANT), isinstance(slaves.get(REFERENCES), TrajectorySlave)
        is_ours = led and isinstance(plant, FmuSlave) and open_fmu(plant.path).is_ours
        is_scene = is_ours and all(slave == name for slave, name in owners.items())
        return Recording(recording.time, as_in_scene(self.system, columns) if is_scene else columns)


def load_ssp(
    path: str | PathLike[str],
    *,
    start: float | None = None,
    stop: float | None = None,
    step: float | None = None,
    loops: LoopSolver | None = None,
    ssd: str = DESCRIPTION,
    output_order: int | None = None,
) -> SspSystem:
    """Load an SSP 1.0 file, or an SSP 2.0 file without its new features, whose components are co-simulation FMUs.

    Subsystems are flattened. Unit conversions, transformations and parameter sets apply at all levels. Inputs connected to the
    system's own input connectors are constant, at the value of a parameter set or else at their start value.

    FMUs of this package behave as in their scene: trajectories pass all derivatives, blocks are sampled at their sample times.
    Other FMUs are sampled if the file has an annotation with their sample time, or if they can't vary their step and their default
    experiment has a step size. All others are stepped at the communication points.

    Args:
        path: path of the SSP file.
        start: start time [s]; None for the file's, else 0.
        stop: stop time [s]; None for the file's, else the latest of an FMU.
        step: communication step [s]; None for the file's, else the smallest step size of an FMU.
        loops: solver of algebraic loops; `Anderson` when None.
        ssd: path of the SSD within the file.
        output_order: highest output derivative requested from FMUs, 0 for values only; None for all that they provide.

    Raises:
        SspError: the file is missing or broken, contradicts itself or its FMUs, or needs an unsupported feature: signal
            dictionaries, SSP files as components, nonlinear tables on the path of a Real, connected calculated parameters.
        FmuFileError: an FMU is broken, of another kind, or has no binary for this platform.
        InputError: a value is out of range, or the slaves can't be connected.
    """
    # content of the file, and its FMUs
    archive = SspArchive(Path(path), ssd)
    structure = read_structure(archive)
    fmus = _fmus(structure, archive)
    remarks = _remarks(structure, fmus)
    if archive.variants:
        others = ", ".join(archive.variants)
        remarks = [f"took {archive.description}; the file also holds {others} (--ssd)", *remarks]
    # connections and start values through all levels
    network = Network(structure, fmus)
    starts, ignored = start_values(structure, fmus, network)
    # slaves for the master, with unique names without dots
    names: dict[str, str] = {}
    for full in fmus:
        name = full.replace(".", "_")
        while name in names.values():
            name += "_"
        names[full] = name
    slaves = [_slave(fmu, names[name], starts[name], output_order) for name, fmu in fmus.items()]
    system = connect(slaves, wires(network, fmus, names), loops=Anderson() if loops is None else loops)
    # times: argument, file, FMUs, in this order
    defaults = [fmu.fmu.description.defaultExperiment for fmu in fmus.values()]
    stops = [float(each.stopTime) for each in defaults if each is not None and each.stopTime]
    steps = [float(each.stepSize) for each in defaults if each is not None and each.stepSize]
    return SspSystem(
        structure,
        system,
        _known("start", archive, start, structure.start, 0.0),
        _known("stop", archive, stop, structure.stop, max(stops, default=None)),
        _known("step", archive, step, structure.step, min(steps, default=None)),
        ignored,
        names,
        shown(structure, network),
        structure.tolerance,
        tuple(dict.fromkeys([*remarks, *network.remarks])),
    )


def _fmus(structure: Structure, archive: SspArchive) -> dict[str, ComponentFmu]:
    """Return full name of a component → its FMU.

    Raises:
        SspError: there is no component, or two elements have the same name.
        FmuFileError: an FMU can't be loaded.
    """
    fmus: dict[str, ComponentFmu] = {}
    names: list[str] = []
    for prefix, level in levels(structure):
        # names are unique within a level
        elements: list[Component | Subsystem] = [*level.systems, *level.components]
        for element in elements:
            if prefix + element.name in names:
                raise SspError(f"{element.where}: another element has the same name; rename one")
            names.append(prefix + element.name)
        for component in level.components:
            path = archive.extract(component.source, component.where)
            # errors of the FMU name the component
            with _named(component):
                fmus[prefix + component.name] = ComponentFmu(component, open_fmu(path))
    if not fmus:
        raise SspError(f"{archive.path}: system {structure.name!r} has no components; there is nothing to run")
    return fmus


@contextmanager
def _named(component: Component) -> Iterator[None]:
    """Context that adds the component and its FMU to error messages.

    Raises:
        FmuFileError: for a `FmuFileError` within.
        SspError: for any other `InputError` within.
    """
    try:
        yield
    except FmuFileError as error:
        reason = re.sub(r"^\S*/flexfmu-\S+-ssp-\S+\.fmu", component.source, str(error))
        raise FmuFileError(f"{component.where}: {reason}") from error
    except InputError as error:
        raise SspError(f"{component.where}: {error}") from error


def _remarks(structure: Structure, fmus: Mapping[str, ComponentFmu]) -> list[str]:
    """Return warnings about ignored parts of the components.

    Raises:
        SspError: a connected connector contradicts its FMU.
    """
    remarks, units = [], {unit.name: unit for unit in structure.units}
    # connected connectors must agree with the FMU; for others a warning suffices
    connected = {
        (prefix + (element or ""), name)
        for prefix, level in levels(structure)
        for each in level.connections
        for element, name in (each.start, each.end)
    }
    for name, fmu in fmus.items():
        used = [each.name for each in fmu.component.connectors if (name, each.name) in connected]
        remarks += check_connectors(fmu, used, units)
        if fmu.component.implementation == "ModelExchange" and not fmu.fmu.is_exchange:
            remarks.append(f"{fmu.component.where} is for model exchange; its FMU's co-simulation was taken")
    return remarks


def _mapped(column: Column, origin: Origin) -> Column:
    """Return a signal in the unit of the connector at the end of its path, after all transformations."""
    unit = origin.unit if isinstance(origin.unit, str) else origin.unit.name
    if isinstance(origin.way, TableMap):
        # each value is looked up once, NaN where the table has no entry
        found: dict[float, float] = {}
        for value in set(column.values.tolist()):
            with suppress(InputError):
                found[value] = origin.way(value)
        return Column(unit, np.array([found.get(value, np.nan) for value in column.values.tolist()]))
    # derivatives are multiplied by the same factor
    factor, offset = origin.way.factor, origin.way.offset
    first, second = (None if each is None else factor * each for each in (column.first, column.second))
    return Column(unit, factor * column.values + offset, first, second, column.texts)


def _slave(fmu: ComponentFmu, name: str, parameters: Mapping[str, Value], output_order: int | None) -> Slave:
    """Return the slave for an FMU; that of an exported trajectory has all its derivatives."""
    path = fmu.fmu.path
    if fmu.fmu.breakpoints and not parameters:
        suffix = f".reference.{KINDS[0][0]}"
        outputs = [each for each in fmu.variables.values() if each.causality == "output"]
        positions = [each for each in outputs if each.name.endswith(suffix)]
        axes = [each.name.removesuffix(suffix) for each in positions]
        return TrajectorySlave(FmuTrajectory(path), axes, positions[0].unit or "", name=name)
    sample_time, offset = fmu.component.sampling or (None, 0.0)
    with _named(fmu.component):
        return fmu_slave(path, name, parameters, sample_time=sample_time, offset=offset, output_order=output_order)


_OPTIONS = {"stop": "--stop-time", "step": "--step"}
"""Time that a file may lack → command-line option."""


def _known(what: str, archive: SspArchive, *values: float | None) -> float:
    """Return the first value that is not None.

    Raises:
        SspError: all values are None.
    """
    for value in values:
        if value is not None:
            return value
    raise SspError(
        f"{archive.path} names no {what} time, nor does any FMU in it; say it: flexfmu run {_OPTIONS[what]} SECONDS, "
        f"load_ssp(path, {what}=...)"
    )


class FoundByBothNames(dict[str, Column]):
    """Columns by their names in the scene, which a look-up finds by their names in the file too."""

    def __init__(self, columns: Mapping[str, Column], by_file: Mapping[str, Column]) -> None:
        super().__init__(columns)
        self._by_file = by_file

    def __missing__(self, name: str) -> Column:
        return self._by_file[name]


def as_in_scene(system: System, columns: Mapping[str, Column]) -> Mapping[str, Column]:
    """Return the columns with the names of the scene's recording; a look-up finds their names in the file, too.

    Args:
        system: the exported scene.
        columns: name in the file, ``plant.joint1.torque`` for example → column.
    """
    unchanged = (each for each in system.connections if each.transformation == IDENTITY)
    ends = (system.describe(each).split(" -> ") for each in unchanged)
    feeding = {target.removeprefix(f"{PLANT}."): source for source, target in ends if target.startswith(f"{PLANT}.")}
    sources = plain_names(columns, PLANT, REFERENCES, feeding)
    found = {name: held(columns[each.name]) if each.held else columns[each.name] for name, each in sources.items()}
    # inputs of the robot that nothing feeds, at the values that the file sets
    plant = next(slave for slave in system.slaves if slave.name == PLANT)
    shape = next(iter(columns.values())).values.shape
    for each in plant.variables:
        value = plant.parameters.get(each.name) if isinstance(plant, FmuSlave) else None
        if each.causality == "input" and each.name not in feeding and isinstance(value, float):
            found[each.name] = held(Column(each.unit, np.broadcast_to(value, shape)))
    return FoundByBothNames(found, columns)
