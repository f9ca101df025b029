"""The recording of a scene from the master's recording: short names, constant inputs, rigid motion."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from flexfmu.cosim.engine.dense_output import integral
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.results import Column, LazyColumns, Recording, Selection
from flexfmu.cosim.engine.slave import RealArray, Sampled, Slave, offset
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.system import PLANT, REFERENCES, SceneSystem
from flexfmu.cosim.experiment.wiring import names_of
from flexfmu.trajectories.trajectory import limits

VELOCITIES = ("joint1.velocity", "joint2.velocity")
"""Outputs of the robot that tell an unstable loop."""


class SceneRecording:
    """Names and completes recordings of a scene.

    Args:
        parts: slaves and wiring.
        rigid: the motion of the rigid robot.
        selection: recorded signals, by names in the scene's recording.

    Attributes:
        needed: recorded signals, by names in the master's recording.

    Raises:
        InputError: a selected signal doesn't exist.
    """

    def __init__(self, parts: SceneSystem, rigid: RigidMotion, selection: Selection) -> None:
        self._rigid, self._selection = rigid, selection
        self._with_rigid = any(map(selection.keeps, rigid.names))
        outputs = {f"{slave.name}.{name}" for slave in parts.slaves for name in names_of(slave, "output")}
        selection.check({*map(_short, outputs), *outputs, *parts.wiring.feeding, *parts.constants, *rigid.names})
        # outputs needed for the selected signals, by the master's names; None for all
        sources: set[str] | None = None
        if selection.names is not None:
            feeding = parts.wiring.feeding
            sources = {name for name in outputs if selection.keeps(name) or selection.keeps(_short(name))}
            sources |= {feeding[name] for name in selection.names if name in feeding}
            # signals that others are derivatives of, for values in between
            integrals = [found[0] for name in sources if (found := integral(name)) is not None]
            sources |= {name for name in integrals if name in outputs}
            if parts.others:
                sources |= {f"{PLANT}.{name}" for name in VELOCITIES} & outputs
        self.needed = Selection(sources, selection.order, selection.step)
        # names in the scene's recording, for the names of the master's
        self._recorded: tuple[str, ...] = ()
        self.named: Mapping[str, Source] = {}

    def follow(self, rigid: RigidMotion) -> None:
        """Complete recordings with another motion of the rigid robot from now on."""
        self._rigid = rigid

    def of(self, recorded: Recording, parts: SceneSystem) -> Recording:
        """The scene's recording from the master's, with short names, unconnected inputs and the rigid motion."""
        time, rigid, values = recorded.time, self._rigid, parts.constants
        named = self._sources(recorded.columns, parts)

        def column(name: str) -> Column:
            source = named[name]
            if source.name:
                return held(recorded[source.name]) if source.held else recorded[source.name]
            if name in values:
                return held(Column(source.unit, np.broadcast_to(values[name], time.shape)))
            return rigid.columns(time)[name]

        return Recording(time, LazyColumns(named, column))

    def _sources(self, recorded: Collection[str], parts: SceneSystem) -> Mapping[str, Source]:
        """Where the selected signals come from, for the names in the master's recording; the same in all runs."""
        if self._recorded != (names := tuple(recorded)):
            found = plain_names(names, PLANT, REFERENCES, parts.wiring.feeding)
            units = {each.name: each.unit for each in parts.plant.variables}
            found |= {name: Source("", unit=units[name]) for name in parts.constants}
            if self._with_rigid:
                found |= dict.fromkeys(self._rigid.names, Source(""))
            self._recorded = names
            self.named = {name: source for name, source in found.items() if self._selection.keeps(name)}
        return self.named


def _short(name: str) -> str:
    """The short name of an output in the scene's recording."""
    owner, _, variable = name.partition(".")
    return variable if owner in (PLANT, REFERENCES) else name


KINDS = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s2"))
"""Order of the time derivative → its name and unit."""


PIECE = 8192
"""Number of instants whose derivatives are evaluated at once."""


@dataclass(frozen=True)
class Source:
    """Where a signal of the scene's recording comes from.

    Attributes:
        name: its name in the master's recording; empty for a constant input and the rigid motion.
        held: whether it is an input, whose missing derivatives are zero.
        unit: unit of a constant input.
    """

    name: str
    held: bool = False
    unit: str = ""


class RigidMotion:
    """The rigid end-effector motion of a plan, cached for runs with the same instants."""

    def __init__(self, motion: MotionPlan) -> None:
        self._motion = motion
        self._time: RealArray | None = None
        self._columns: Mapping[str, Column] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals."""
        return tuple(f"end_effector.reference.{kind}.{axis}" for kind, _ in KINDS for axis in "xy")

    def columns(self, time: RealArray) -> Mapping[str, Column]:
        """Columns such as ``end_effector.reference.position.x`` at a recording's times, with derivatives.

        An instant that appears twice has the left limit, then the right one.
        """
        if self._time is None or not np.array_equal(time, self._time):
            # a copy: a view would keep the recorder's memory, which then couldn't serve the next run
            self._time, self._columns = time.copy(), self._calculate(time)
        return self._columns

    def _calculate(self, time: RealArray) -> Mapping[str, Column]:
        left = np.append(time[:-1] == time[1:], False)
        # piece by piece, which needs little memory beside the result
        derivatives = np.empty((5, 2, time.size))
        for begin in range(0, time.size, PIECE):
            piece = slice(begin, begin + PIECE)
            derivatives[:, :, piece] = limits(self._motion.task, time[piece], left[piece], 4).swapaxes(1, 2)
        return {
            f"end_effector.reference.{kind}.{axis}": Column(unit, *derivatives[order : order + 3, i])
            for order, (kind, unit) in enumerate(KINDS)
            for i, axis in enumerate("xy")
        }


@dataclass(frozen=True)
class SlaveFacts:
    """Facts about a slave for the summary.

    Attributes:
        name: name of the slave.
        description: kind of the slave.
        sample_time, offset: [s]; None for a slave that isn't sampled, or at given instants alone.
    """

    name: str
    description: str
    sample_time: float | None = None
    offset: float | None = None


def slave_facts(slaves: Sequence[Slave]) -> tuple[SlaveFacts, ...]:
    """Facts about the slaves for the summary."""
    found = []
    for slave in slaves:
        clock = (slave.sample_time, offset(slave)) if isinstance(slave, Sampled) and slave.sample_time < inf else ()
        found.append(SlaveFacts(slave.name, _description(slave), *clock))
    return tuple(found)


def plain_names(
    recorded: Collection[str], plant: str, references: str, feeding: Mapping[str, str]
) -> dict[str, Source]:
    """Short names of recorded signals → where these come from.

    Outputs of the plant, its inputs (such as ``joint1.torque``) and the trajectory's outputs have their own names. All other
    signals, and references that an inline block replaces, have the name ``slave.variable``.

    Args:
        recorded: names ``slave.variable``.
        plant, references: names of these slaves.
        feeding: input of the plant → ``slave.output`` connected to it; ignored if that isn't recorded.
    """
    found: dict[str, Source] = {}
    for name in recorded:
        owner, _, variable = name.partition(".")
        superseded = owner == references and feeding.get(variable, name) != name
        found[variable if owner in (plant, references) and not superseded else name] = Source(name)
    acting = [(name, source) for name, source in feeding.items() if name not in found and source in recorded]
    return found | {name: Source(source, held=True) for name, source in acting}


def held(column: Column) -> Column:
    """The column with zeros for missing derivatives, since the signal is held constant."""
    zero = np.broadcast_to(0.0, column.values.shape)
    first = zero if column.first is None else column.first
    return Column(column.unit, column.values, first, zero if column.second is None else column.second)


def _description(slave: Slave) -> str:
    """Description of a slave's kind."""
    # blocks describe themselves
    block = getattr(slave, "block", None)
    if block is not None:
        return str(block.description)
    # other slaves by their class, FMUs with the name of their model
    names = {
        "FmuSlave": "FMU",
        "SampledFmu": "FMU, sampled",
        "FmuTask": "FMU, sampled, with outputs calculated in its step",
        "TrajectorySlave": "Planned motion",
        "Lag": "First-order lag in continuous time",
    }
    what = names.get(type(slave).__name__, type(slave).__name__)
    path = getattr(slave, "path", None)
    return what if path is None else f"{what}: {open_fmu(Path(path)).description.modelName}"
