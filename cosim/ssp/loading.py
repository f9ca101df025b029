"""A system from an SSP file, ready to be simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from flexfmu.cosim.fmu.annotations import breakpoints
from flexfmu.cosim.fmu.file import open_fmu
from flexfmu.cosim.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.fmu.trajectory import FmuTrajectory
from flexfmu.cosim.fmu.variables import Value
from flexfmu.cosim.master.algorithms import Algorithm
from flexfmu.cosim.master.isolation import CALL_LIMIT, isolation
from flexfmu.cosim.master.iteration import Anderson, LoopSolver
from flexfmu.cosim.master.master import Progress, Simulation, simulate
from flexfmu.cosim.master.step_control import StepDoubling
from flexfmu.cosim.master.system import System, connect
from flexfmu.cosim.slave import Slave
from flexfmu.cosim.ssp.archive import SspArchive
from flexfmu.cosim.ssp.parameters import start_values
from flexfmu.cosim.ssp.reading import read_structure
from flexfmu.cosim.ssp.structure import SspError, Structure
from flexfmu.cosim.ssp.variables import ComponentFmu, component_fmu
from flexfmu.cosim.ssp.wiring import wires
from flexfmu.cosim.trajectory_slave import REFERENCES, TrajectorySlave


@dataclass(frozen=True)
class SspSystem:
    """A system that an SSP file describes.

    Attributes:
        structure: what the file says.
        system: slaves and connections.
        start, stop: [s].
        step: communication step [s].
        ignored: parameters in the file that fit no variable.
    """

    structure: Structure
    system: System
    start: float
    stop: float
    step: float
    ignored: tuple[str, ...]

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
        """Run it with `flexfmu.cosim.master.master.simulate`; without a tolerance the FMUs use their own.

        Args:
            tolerance, progress, algorithm, step_control: see there.
            isolate: whether to simulate in a child process; where other tools' FMUs take part when None.
            call_limit: how long an FMU may stay in one call there [s].

        Raises:
            InputError: the times make no sense, or a slave would have to go back to an earlier state but can't.
        """
        return simulate(
            self.system,
            self.stop,
            self.step,
            start=self.start,
            tolerance=tolerance,
            progress=progress,
            algorithm=algorithm,
            step_control=step_control,
            isolation=isolation(isolate, self.system.slaves, call_limit, theirs=False),
        )


def load_ssp(
    path: str | PathLike[str],
    *,
    start: float | None = None,
    stop: float | None = None,
    step: float | None = None,
    loops: LoopSolver | None = None,
) -> SspSystem:
    """Read an SSP file of SSP 1.0 whose components are FMUs of FMI 2.0 for co-simulation.

    FMUs that this package made run as in the scene they come from: trajectories are streamed with all derivatives, blocks
    are sampled at their own instants. Others are sampled where the file has an annotation with their sample time, or where
    they can't vary their step and their default experiment has a step size; else they are stepped. Units are converted, linear transformations and parameter sets
    applied. What the system's own input connectors feed stays at its start value.

    Args:
        path: the file.
        start, stop: [s]; by default what the file says, else 0 and the latest stop time that an FMU names.
        step: communication step [s]; by default what the file says, else the smallest that an FMU names.
        loops: how algebraic loops are solved; `Anderson` when None.

    Raises:
        SspError: the file is missing, broken, contradicts itself or its FMUs, or needs what this program doesn't do:
            nested systems, signal dictionaries, mappings that aren't linear, model exchange, connected parameters.
        FmuFileError: an FMU is broken, of another kind, or has no binary for this platform.
        InputError: a value is out of range, or the slaves can't be wired.
    """
    archive = SspArchive(Path(path))
    structure = read_structure(archive)
    fmus = _fmus(structure, archive)
    starts = start_values(structure, fmus)
    names = _names(structure)
    slaves = [_slave(fmu, names[name], starts.values[name]) for name, fmu in fmus.items()]
    system = connect(slaves, wires(structure, fmus, names), loops=Anderson() if loops is None else loops)
    defaults = [fmu.fmu.description.defaultExperiment for fmu in fmus.values()]
    stops = [float(each.stopTime) for each in defaults if each is not None and each.stopTime]
    steps = [float(each.stepSize) for each in defaults if each is not None and each.stepSize]
    return SspSystem(
        structure,
        system,
        _first(start, structure.start, 0.0),
        _known("stop", archive, stop, structure.stop, max(stops, default=None)),
        _known("step", archive, step, structure.step, min(steps, default=None)),
        starts.ignored,
    )


def _fmus(structure: Structure, archive: SspArchive) -> dict[str, ComponentFmu]:
    """Name of a component → its FMU.

    Raises:
        SspError: there is none, or two share a name.
    """
    fmus: dict[str, ComponentFmu] = {}
    for component in structure.components:
        if component.name in fmus:
            raise SspError(f"{component.where}: another component has the same name; rename one")
        fmu = open_fmu(archive.extract(component.source, component.where))
        fmus[component.name] = component_fmu(component, fmu, structure.units)
    if not fmus:
        raise SspError(f"{archive.path}: system {structure.name!r} has no components; there is nothing to run")
    return fmus


def _names(structure: Structure) -> Mapping[str, str]:
    """Name of a component → name of its slave, which holds no dot."""
    return {each.name: each.name.replace(".", "_") for each in structure.components}


def _slave(fmu: ComponentFmu, name: str, parameters: Mapping[str, Value]) -> Slave:
    """The slave that suits an FMU."""
    if breakpoints(fmu.fmu) and not parameters:
        return _trajectory(fmu, name)
    sample_time, offset = fmu.component.sampling or (None, 0.0)
    return fmu_slave(fmu.fmu.path, name, parameters, sample_time=sample_time, offset=offset)


def _trajectory(fmu: ComponentFmu, name: str) -> Slave:
    """An exported trajectory, streamed as the motion itself is."""
    suffix = f".reference.{REFERENCES[0][0]}"
    outputs = [each for each in fmu.variables.values() if each.causality == "output"]
    positions = [each for each in outputs if each.name.endswith(suffix)]
    axes = [each.name.removesuffix(suffix) for each in positions]
    return TrajectorySlave(FmuTrajectory(fmu.fmu.path), axes, positions[0].unit or "", name=name)


def _first(*values: float | None) -> float:
    """The first that is known."""
    return next(value for value in values if value is not None)


_OPTIONS = {"stop": "--stop-time", "step": "--step"}
"""What the file may leave open → the command's option for it."""


def _known(what: str, archive: SspArchive, *values: float | None) -> float:
    """The first that is known.

    Raises:
        SspError: none is.
    """
    known: Sequence[float] = [value for value in values if value is not None]
    if not known:
        raise SspError(
            f"{archive.path} names no {what} time, nor does any FMU in it; say it: flexfmu run {_OPTIONS[what]} SECONDS, "
            f"load_ssp(path, {what}=...)"
        )
    return known[0]
