"""Signals of an exported scene: the same names as in the scene's own recording."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.linear_map import IDENTITY
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.results import Column
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.recording import held, plain_names
from flexfmu.cosim.experiment.system import PLANT, REFERENCES


class FoundByBothNames(dict[str, Column]):
    """Columns by their names in the scene, which a look-up finds by their names in the file too."""

    def __init__(self, columns: Mapping[str, Column], by_file: Mapping[str, Column]) -> None:
        super().__init__(columns)
        self._by_file = by_file

    def __missing__(self, name: str) -> Column:
        return self._by_file[name]


def is_exported_scene(system: System) -> bool:
    """Return whether a system is an exported scene: our robot as ``plant``, led by our ``trajectory``."""
    slaves = {slave.name: slave for slave in system.slaves}
    plant = slaves.get(PLANT)
    is_ours = isinstance(plant, FmuSlave) and open_fmu(plant.path).is_ours
    return is_ours and isinstance(slaves.get(REFERENCES), TrajectorySlave)


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
