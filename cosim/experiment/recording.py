"""The recording of a scene from that of the master: short names, and the rigid motion beside the robot's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.results import Column, Recording, Selection
from flexfmu.cosim.engine.slave import RealArray, Sampled, Slave, offset
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.system import PLANT, REFERENCES, SceneSystem
from flexfmu.trajectories.trajectory import limits


class SceneRecording:
    """Names and completes recordings of a scene.

    Args:
        parts: slaves and wiring.
        rigid: the motion of the rigid robot.
        selection: what to keep, by the names in the finished recording.

    Attributes:
        needed: the same by the names of the master.

    Raises:
        InputError: there is no such signal.
    """

    def __init__(self, parts: SceneSystem, rigid: RigidMotion, selection: Selection) -> None:
        self._rigid, self._selection = rigid, selection
        self._with_rigid = any(map(selection.keeps, rigid.names))
        outputs = {
            f"{slave.name}.{variable.name}"
            for slave in parts.slaves
            for variable in slave.variables
            if variable.causality == "output"
        }
        selection.check({*map(_short, outputs), *outputs, *parts.wiring.feeding, *parts.constants, *rigid.names})
        # outputs that the signals to keep are made of, by the master's names; None for all
        sources: set[str] | None = None
        if selection.names is not None:
            feeding = parts.wiring.feeding
            sources = {name for name in outputs if selection.keeps(name) or selection.keeps(_short(name))}
            sources |= {feeding[name] for name in selection.names if name in feeding}
        self.needed = Selection(sources, selection.order)

    def of(self, recorded: Recording, parts: SceneSystem) -> Recording:
        """What was recorded, with short names and the torques that nothing feeds."""
        time, columns = recorded.time, plain_names(recorded.columns, PLANT, REFERENCES, parts.wiring.feeding)
        columns |= constants(parts.plant, parts.constants, time.size)
        if self._with_rigid:
            columns |= self._rigid.columns(time)
        return self._selection.of(Recording(time, columns))


def _short(name: str) -> str:
    """The name that a finished recording may have for an output."""
    owner, _, variable = name.partition(".")
    return variable if owner in (PLANT, REFERENCES) else name


KINDS = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s2"))
"""Order of the time derivative → its name and unit."""


class RigidMotion:
    """The rigid end-effector motion of a plan; runs at the same instants calculate it once."""

    def __init__(self, motion: MotionPlan) -> None:
        self._motion = motion
        self._time = np.empty(0)
        self._columns: Mapping[str, Column] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals."""
        return tuple(f"end_effector.reference.{kind}.{axis}" for kind, _ in KINDS for axis in "xy")

    def columns(self, time: RealArray) -> Mapping[str, Column]:
        """``end_effector.reference.position.x`` and so on at a recording's times, with their derivatives, on both sides of
        every instant that appears twice."""
        if not np.array_equal(time, self._time):
            self._time, self._columns = time, self._calculate(time)
        return self._columns

    def _calculate(self, time: RealArray) -> Mapping[str, Column]:
        left = np.append(time[:-1] == time[1:], False)
        derivatives = limits(self._motion.task, time, left, 4)
        return {
            f"end_effector.reference.{kind}.{axis}": Column(unit, *derivatives[order : order + 3, :, i].copy())
            for order, (kind, unit) in enumerate(KINDS)
            for i, axis in enumerate("xy")
        }


@dataclass(frozen=True)
class SlaveFacts:
    """A slave as the summary lists it.

    Attributes:
        name: its name in the system.
        description: what it is.
        sample_time, offset: [s]; None for a slave that isn't sampled.
    """

    name: str
    description: str
    sample_time: float | None = None
    offset: float | None = None


def slave_facts(slaves: Sequence[Slave]) -> tuple[SlaveFacts, ...]:
    """The slaves as the summary lists them."""
    return tuple(
        SlaveFacts(slave.name, _description(slave), slave.sample_time, offset(slave))
        if isinstance(slave, Sampled)
        else SlaveFacts(slave.name, _description(slave))
        for slave in slaves
    )


def plain_names(
    recorded: Mapping[str, Column], plant: str, references: str, feeding: Mapping[str, str]
) -> dict[str, Column]:
    """What was recorded, with short names.

    What the plant outputs, what acts on it in the end (such as ``joint1.torque``) and, where the name isn't taken, what
    the trajectory outputs have their own names; all others, and whatever was superseded, are ``slave.variable``.

    Args:
        recorded: columns named ``slave.variable``.
        plant, references: names of these slaves.
        feeding: input of the plant → ``slave.output`` that feeds it; left out where that wasn't recorded.
    """
    columns: dict[str, Column] = {}
    for name, column in recorded.items():
        owner, _, variable = name.partition(".")
        superseded = owner == references and feeding.get(variable, name) != name
        columns[variable if owner in (plant, references) and not superseded else name] = column
    acting = [(name, source) for name, source in feeding.items() if name not in columns and source in recorded]
    return columns | {name: held(recorded[source]) for name, source in acting}


def held(column: Column) -> Column:
    """The column with zero for derivatives that its slave doesn't give: the signal is held."""
    zero = np.zeros_like(column.values)
    first = zero if column.first is None else column.first
    return Column(column.unit, column.values, first, zero if column.second is None else column.second)


def constants(plant: Slave, values: Mapping[str, float], count: int) -> dict[str, Column]:
    """The plant's inputs that nothing feeds, at the values that they keep at so many instants."""
    units = {each.name: each.unit for each in plant.variables if each.name in values}
    return {name: held(Column(units[name], np.full(count, value))) for name, value in values.items()}


def _description(slave: Slave) -> str:
    """What a slave is."""
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
