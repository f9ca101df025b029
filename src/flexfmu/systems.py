"""Parts of a scene's loop given in Python, and systems of slaves without a scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import isfinite
from os import PathLike, fspath
from typing import Any, TypedDict

from flexfmu.cosim.engine.child_process import CALL_LIMIT
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.master.iteration import Anderson
from flexfmu.cosim.engine.master.simulator import Progress, Simulation, isolation
from flexfmu.cosim.engine.master.simulator import simulate as simulate_system
from flexfmu.cosim.engine.master.system import connect as connect_slaves
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.experiment.user_slaves import SlaveNames, as_slave
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.schema import Scene
from flexfmu.model.scene.section import Section
from flexfmu.model.symbolic import SymbolicModel

Part = Any
"""A part of the loop: what a function of `flexfmu.control`, `flexfmu.shapers` ... returns, the same as a table (dict), a function with
`flexfmu.controller`, an object of a class with the methods of a slave, a python-control system, or the path of an FMU."""


class Parts(TypedDict, total=False):
    """Parts of the loop instead of the scene's own; what is left out, or None, stays as in the scene."""

    controllers: Iterable[Part] | None
    shapers: Iterable[Part] | None
    imperfections: Iterable[Part] | None
    filters: Iterable[Part] | None
    disturbances: Iterable[Part] | None
    connect: Mapping[str, str] | None


FAMILIES = {
    "controllers": "controller",
    "shapers": "shaper",
    "imperfections": "imperfection",
    "filters": "filter",
    "disturbances": "disturbance",
}
"""Argument → key of the scene."""

HOMES = {name: name for name in FAMILIES}
"""Module of a section in `flexfmu.model.scene` → family; what users bring belongs to every one."""

OWN = ("controllers", "shapers", "imperfections")
"""Families whose parts may be objects."""


def with_parts(scene: Scene, parts: Parts) -> Scene:
    """The scene with these parts of its loop; torques drive its robot if there are controllers among them.

    Raises:
        TypeError: an argument isn't one of `Parts`.
        InputError: an object can't be a part of its family, or there is nothing to connect.
        SceneError: a value is invalid.
    """
    if unknown := parts.keys() - Parts.__annotations__.keys():
        raise TypeError(
            f"unexpected argument {min(unknown)!r}; parts of the loop are {', '.join(Parts.__annotations__)}"
        )
    given = {family: parts.get(family) for family in FAMILIES}
    changes: dict[str, Any] = {
        FAMILIES[family]: [_table(each, family) for each in listed(entries, family)]
        for family, entries in given.items()
        if entries is not None
    }
    if changes.get("controller"):
        changes["cosimulation.drive"] = "torque"
    changed = scene.replace(changes) if changes else scene
    connect = parts.get("connect")
    if not connect:
        return changed
    if not isinstance(connect, Mapping):
        raise InputError(
            f"connect gives the source of each input, got {connect!r}: write {{'slave.input': 'slave.output'}}"
        )
    for key in ("controller", "imperfection", "shaper"):
        for index, section in enumerate(getattr(changed, key)):
            if hasattr(section, "connect"):
                return changed.replace({f"{key}[{index}].connect": {**section.connect, **connect}})
    raise InputError(
        f"connect needs a controller, shaper or imperfection, {scene.name} has none: give controllers=[...]"
    )


def listed(entries: Any, family: str) -> list[Part]:
    """The entries of a family.

    Raises:
        InputError: it is one entry instead of a list of them.
    """
    if isinstance(entries, Section | Mapping | str | PathLike) or not isinstance(entries, Iterable):
        raise InputError(f"{family} is a list, got {type(entries).__name__}: write {family}=[...]")
    return list(entries)


def _table(entry: Part, family: str) -> Any:
    """A part as the scene takes it.

    Raises:
        InputError: it is an object in a family that takes none.
    """
    right = HOMES.get(type(entry).__module__.rpartition(".")[2], family) if isinstance(entry, Section) else family
    if right != family:
        raise InputError(f"{entry.kind!r} is one of the {right}, not of the {family}: give it in {right}=[...]")
    if isinstance(entry, Section | Mapping):
        return entry
    if family not in OWN:
        raise InputError(
            f"{family} are made by flexfmu.{family}, got {type(entry).__name__}: give an object of yours as one of {', '.join(OWN)}"
        )
    if isinstance(entry, str | PathLike):
        return {"kind": "fmu", "path": fspath(entry)}
    return entry


def wires(connections: Mapping[str, str] | None) -> list[tuple[str, str]]:
    """Pairs (``slave.output``, ``slave.input``) of a user's connections.

    Raises:
        InputError: these are no dict.
    """
    if not isinstance(connections or {}, Mapping):
        raise InputError(
            f"connections give the source of each input, got {connections!r}: write {{'load.u': 'drive.y'}}"
        )
    return [(source, target) for target, source in (connections or {}).items()]


def slave(
    source: Any,
    name: str | None = None,
    *,
    parameters: Mapping[str, float | int | bool | str] | None = None,
    sample_time: float | None = None,
) -> Slave:
    """Make a slave for `simulate` of an FMU, a model from equations (`flexfmu.ode` ...), a function with `flexfmu.controller`, a
    python-control system, a block or an object.

        motor = flexfmu.slave("motor.fmu", "motor", parameters={"inertia": 0.1})

    Args:
        source: path of an FMU, or one of the others.
        name: name of the slave; None for that of the file, model, function or object.
        parameters: name → start value, of an FMU or a model.
        sample_time: period [s] at which an FMU is stepped; None for its own, or every communication step.

    Returns:
        The slave, with its ``variables``.

    Raises:
        InputError: the source can't be a slave, the FMU can't be loaded or lacks a parameter, or parameters or a sample time are
            given for something else.
        BuildError: the FMU of a model can't be built.
    """
    if isinstance(source, str | PathLike | SymbolicModel):
        path = fspath(build_fmu(source).path if isinstance(source, SymbolicModel) else source)
        known = SlaveNames(()).of_file(source.name if isinstance(source, SymbolicModel) else path, name)
        return fmu_slave(path, known, dict(parameters or {}), sample_time=sample_time)
    if parameters or sample_time is not None:
        raise InputError(f"parameters and sample_time are those of an FMU, got {type(source).__name__}: leave them out")
    return as_slave(source, SlaveNames(()), name)


def simulate(
    slaves: Iterable[Any] | SymbolicModel | str | PathLike[str],
    connections: Mapping[str, str] | None = None,
    *,
    stop_time: float,
    step: float,
    start_time: float = 0.0,
    tolerance: float | None = None,
    record: Iterable[str] | None = None,
    isolate: bool | None = None,
    loops: bool = False,
    progress: Progress | None = None,
) -> Simulation:
    """Co-simulate slaves without a scene: FMUs of any tool, models from equations, Python objects, python-control systems.

        found = flexfmu.simulate(["drive.fmu", "load.fmu"], {"load.torque": "drive.torque"}, stop_time=1.0, step=1e-3)
        found.recording["load.speed"].values, found.outcome

    Args:
        slaves: what `slave` makes, or takes; a model or the path of an FMU alone too.
        connections: ``slave.input`` → ``slave.output``.
        stop_time, start_time: [s].
        step: communication step [s]; instants of sampled slaves are met exactly beside it.
        tolerance: relative tolerance of the slaves' integrators; None for their own.
        record: names of the signals to record; None for all.
        isolate: whether slaves run in a child process (Linux), so that one that crashes or hangs ends only the run; None for other
            tools' FMUs.
        loops: whether outputs and inputs that depend on each other at one instant are solved for by iteration (Anderson's), as of
            FMUs that don't declare what their outputs depend on.
        progress: function that is called with the simulated fraction, 0 to 1.

    Returns:
        ``recording``, ``outcome`` and ``message``. If a slave fails during the run, nothing is raised: the recording ends there.

    Raises:
        InputError: a slave can't be made, names or units don't fit, outputs and inputs depend on each other at one instant, or
            times don't fit together.
    """
    names = SlaveNames(())  # nothing is reserved without a scene
    slaves = [slaves] if isinstance(slaves, SymbolicModel | str | PathLike) else slaves
    made = [as_slave(each, names) for each in listed(slaves, "slaves")]
    if not made:
        raise InputError("there is nothing to simulate: give at least one slave")
    for what, value in (("stop_time", stop_time), ("step", step), ("start_time", start_time)):
        if isinstance(value, str) or not isfinite(value):
            raise InputError(f"{what} must be a finite number of seconds, got {value!r}")
    solver = Anderson() if loops else None
    system = connect_slaves(made, wires(connections), loops=solver)
    return simulate_system(
        system,
        stop_time,
        step,
        start=start_time,
        tolerance=tolerance,
        progress=progress,
        record=EVERYTHING if record is None else Selection(listed(record, "record")),
        isolation=isolation(isolate, made, CALL_LIMIT, caller_owned=True),
    )
