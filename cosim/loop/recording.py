"""What a recording of a loop calls its signals, and which slaves made them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexfmu.cosim.fmu.file import open_fmu
from flexfmu.cosim.results import Column
from flexfmu.cosim.slave import Sampled, Slave, offset


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

    What the plant puts out, what acts on it in the end (such as ``joint1.torque``) and, where the name isn't taken, what
    the trajectory puts out have their own names; all others, and whatever was superseded, are ``slave.variable``.

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
    block = getattr(slave, "block", None)
    if block is not None:
        return str(block.description)
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
