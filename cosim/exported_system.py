"""A scene as FMUs: where they are and how they are connected, by the names that their variables have."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.cosim.fmu.variables import Value
from flexfmu.cosim.loop.recording import SlaveFacts
from flexfmu.fmu_build.naming import namer

if TYPE_CHECKING:
    from flexfmu.fmu_build.naming import Naming


@dataclass(frozen=True)
class ExportedSlave:
    """A slave of a scene as an FMU.

    Attributes:
        facts: its name in the system, what it is, its sample time and offset.
        path: the FMU.
        parameters: start values that differ from those in the FMU.
    """

    facts: SlaveFacts
    path: Path
    parameters: Mapping[str, Value] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its name in the system."""
        return self.facts.name


@dataclass(frozen=True)
class ExportedSystem:
    """All of a scene as FMUs.

    Attributes:
        slaves: the planned motion (``trajectory``), the robot (``plant``), then controllers, shapers and imperfections.
        connections: pairs (``slave.output``, ``slave.input``), between exported slaves alone, named as in the FMUs.
        step, stop_time: communication step and end of the simulation [s].
    """

    slaves: tuple[ExportedSlave, ...]
    connections: tuple[tuple[str, str], ...]
    step: float
    stop_time: float

    def named(self, naming: Naming, slaves: Collection[str]) -> ExportedSystem:
        """The same with the variables of these slaves named so.

        Raises:
            ModelError: a variable has no flat name.
        """
        name = namer(naming)

        def port(end: str) -> str:
            slave, _, variable = end.partition(".")
            return f"{slave}.{name(variable)}" if slave in slaves else end

        def renamed(slave: ExportedSlave) -> ExportedSlave:
            starts = {name(key): value for key, value in slave.parameters.items()}
            return replace(slave, parameters=starts) if slave.name in slaves else slave

        connections = tuple((port(source), port(target)) for source, target in self.connections)
        return replace(self, slaves=tuple(map(renamed, self.slaves)), connections=connections)
