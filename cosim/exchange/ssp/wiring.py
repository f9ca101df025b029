"""The source of each connector's signal, through systems within systems, and the resulting connections for the master.

A system's own connector passes on the values from outside (inputs, parameters) or from inside (outputs). Along the path values are
converted between units, then transformed, connection by connection (SSP 1.0: elements Connection and LinearTransformation).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from flexfmu.cosim.engine.errors import suggestion
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.master.linear_map import IDENTITY, SignalMap, TableMap
from flexfmu.cosim.engine.master.system import Wire
from flexfmu.cosim.engine.slave import TAKES
from flexfmu.cosim.exchange.ssp.structure import (
    Connector,
    SspConnection,
    SspError,
    SspUnit,
    Structure,
    Subsystem,
    ValueMap,
    levels,
)
from flexfmu.cosim.exchange.ssp.variables import ComponentFmu, conversion, unit_of

ConnectorName = tuple[str, str]
"""Full name of an element (``inner.first``; empty for the whole system) and its connector."""

_TAKERS, _GIVERS = ("input", "parameter"), ("output", "calculatedParameter")
"""Kinds of connectors that are targets and sources of connections. For the system's own connectors, seen from inside, the roles
are exchanged."""


@dataclass(frozen=True)
class Origin:
    """The origin of a signal.

    Attributes:
        node: an FMU's output, or a system's connector without a source.
        way: the transformation along the path.
        unit: unit of the signal at its end; empty where it isn't stated.
        where: the last connection of the path, for errors.
    """

    node: ConnectorName
    way: SignalMap = IDENTITY
    unit: SspUnit | str = ""
    where: str = ""


class Network:
    """All connections of a system and those within it.

    Args:
        structure: the system.
        fmus: full name of a component → the component with its FMU.

    Attributes:
        connectors: of all elements.
        feeds: target connector → its source connector, and the connection.
        units: name → unit that the structure defines.
        value_units: connector without a unit → unit of its value in a parameter set.
        remarks: warnings for the user.

    Raises:
        SspError: an end of a connection doesn't exist, its direction is wrong, or a target has two sources.
    """

    def __init__(self, structure: Structure, fmus: Mapping[str, ComponentFmu]) -> None:
        self._fmus = fmus
        self.units = {unit.name: unit for unit in structure.units}
        self.value_units: dict[ConnectorName, SspUnit | str] = {}
        self.remarks: list[str] = []
        # connectors of systems and components by their full names
        self.connectors: dict[ConnectorName, Connector] = {}
        self.feeds: dict[ConnectorName, tuple[ConnectorName, SspConnection]] = {}
        for prefix, level in levels(structure):
            for each in level.connectors:
                self.connectors[prefix[:-1], each.name] = each
            for component in level.components:
                for each in component.connectors:
                    self.connectors[prefix + component.name, each.name] = each
        for prefix, level in levels(structure):
            for connection in level.connections:
                self._add(connection, prefix, level)

    def origin(self, node: ConnectorName, values: Collection[ConnectorName] | None = None) -> Origin | None:
        """The source of the connector's signal; None for a connector without one.

        Args:
            node: the connector.
            values: connectors of systems with a value of their own; if given, only these count as origins.

        Raises:
            SspError: connections form a ring, units don't match, or a table on the path doesn't match the signal.
        """
        # follow the connections back to the first source; a ring has none
        way = [node]
        while way[-1] in self.feeds:
            way.append(self.feeds[way[-1]][0])
            if way[-1] in way[:-1]:
                ring = " <- ".join(_full_name(each) for each in way)
                raise SspError(f"{self.feeds[node][1].where}: connectors feed each other in a ring: {ring}; open it")
        # go back to the last connector with a value of its own
        while values is not None and len(way) > 1 and way[-1][0] not in self._fmus and way[-1] not in values:
            way.pop()
        # compose unit conversions and transformations from there to the target
        found: SignalMap = IDENTITY
        unit = self.unit(way[-1])
        for taker in reversed(way[:-1]):
            connection, own = self.feeds[taker][1], self.unit(taker)
            if connection.converts_units:
                found = found.then(conversion(unit, own, connection.where, self.remarks))
            found = found.then(self._map(connection, way[-1], way[0]))
            unit = own or unit
        return None if len(way) == 1 else Origin(way[-1], found, unit, self.feeds[node][1].where)

    def unit(self, node: ConnectorName) -> SspUnit | str:
        """Unit of a connector, its bare name where it isn't defined, empty where it isn't stated."""
        connector = self.connectors[node]
        if node[0] in self._fmus:
            return unit_of(connector, self._fmus[node[0]], self.units)
        return self.units.get(connector.unit or "", connector.unit or self.value_units.get(node, ""))

    def _map(self, connection: SspConnection, origin: ConnectorName, end: ConnectorName) -> SignalMap:
        """The transformation of a connection.

        Raises:
            SspError: it is a nonlinear table for a Real, or a table of items that the signal doesn't have.
        """
        # a linear map where possible, else a table
        table = connection.transformation
        if not isinstance(table, ValueMap):
            return table
        if (line := table.linear()) is not None:
            return line
        if origin[0] in self._fmus and self._fmus[origin[0]].type(origin[1]) == "Real":
            raise SspError(
                f"{connection.where} has a table that is no line, in which a Real can't be looked up; map it inside an FMU"
            )
        # items as the integers that stand for them
        pairs = {
            self._number(source, origin, connection): self._number(target, end, connection)
            for source, target in table.pairs
        }
        return TableMap(tuple(pairs.items()))

    def _number(self, value: Value, node: ConnectorName, connection: SspConnection) -> int:
        """A value of a table, the number of an item for its name.

        Raises:
            SspError: the variable has no such item.
        """
        if not isinstance(value, str):
            return int(value)
        items = self._fmus[node[0]].items(node[1]) if node[0] in self._fmus else {}
        if value not in items:
            raise SspError(
                f"{connection.where} has a table with the item {value!r}, which {_full_name(node)} doesn't have; it has: "
                f"{', '.join(items) or 'none'}"
            )
        return items[value]

    def _add(self, connection: SspConnection, prefix: str, level: Subsystem) -> None:
        """Add a connection from source to target."""
        ends = [self._end(connection, *end, prefix, level) for end in (connection.start, connection.end)]
        # seen from inside, a system's inputs are sources and its outputs are targets
        kinds = [self.connectors[node].kind for node in ends]
        own = connection.start[0] is None, connection.end[0] is None
        gives = [kind in (_TAKERS if inside else _GIVERS) for kind, inside in zip(kinds, own, strict=True)]
        if gives.count(True) != 1 or "inout" in kinds:
            raise SspError(f"{connection.where} joins {kinds[0]} and {kinds[1]}; connect an output and an input")
        giver, taker = ends if gives[0] else reversed(ends)
        if taker in self.feeds:
            raise SspError(f"{connection.where}: {_full_name(taker)} is connected twice; keep one source")
        self.feeds[taker] = giver, connection

    def _end(
        self, connection: SspConnection, element: str | None, name: str, prefix: str, level: Subsystem
    ) -> ConnectorName:
        """Return the connector at an end of a connection.

        Raises:
            SspError: there is none.
        """
        # components and systems of this level may be named
        elements = {each.name: each.connectors for each in level.components}
        elements |= {each.name: each.connectors for each in level.systems}
        if element is not None and element not in elements:
            raise SspError(
                f"{connection.where} names the element {element!r}, which doesn't exist; {suggestion(element, elements)}"
            )
        known = [each.name for each in (level.connectors if element is None else elements[element])]
        if name not in known:
            owner = (
                f"the connector {name!r}, which {element!r} doesn't have"
                if element
                else f"the system's connector {name!r}, which doesn't exist"
            )
            raise SspError(f"{connection.where} names {owner}; {suggestion(name, known)}")
        return (prefix[:-1] if element is None else prefix + element), name


def wires(network: Network, fmus: Mapping[str, ComponentFmu], names: Mapping[str, str]) -> list[Wire]:
    """Connections between components, for the master.

    Args:
        network: all connections.
        fmus: full name of a component → the component with its FMU.
        names: full name of a component → name of its slave.

    Raises:
        SspError: types or units don't fit, or a parameter would change during the run.
    """
    found: list[Wire] = []
    for node in network.feeds:
        origin = network.origin(node) if node[0] in fmus else None
        if origin is None or origin.node[0] not in fmus:
            continue
        # only outputs feed inputs during a run, and types must suit
        kinds = network.connectors[origin.node].kind, network.connectors[node].kind
        if kinds != ("output", "input"):
            raise SspError(
                f"{origin.where} joins {kinds[0]} and {kinds[1]}; parameters are set before the run: use a parameter set"
            )
        types = [fmus[element].type(name) for element, name in (origin.node, node)]
        if types[0] not in TAKES[types[1]]:
            raise SspError(
                f"{origin.where} feeds {types[1]} {_full_name(node)!r} from {types[0]} {_full_name(origin.node)!r}; convert in an FMU"
            )
        source, target = (f"{names[element]}.{name}" for element, name in (origin.node, node))
        found.append((source, target, origin.way))
    return found


def shown(structure: Structure, network: Network) -> dict[str, Origin]:
    """Return full name of a system's connector → origin of its signal, for the results."""
    nodes = [(prefix[:-1], each.name) for prefix, level in levels(structure) for each in level.connectors]
    found = {_full_name(node): network.origin(node) for node in nodes}
    return {name: origin for name, origin in found.items() if origin is not None}


def _full_name(node: ConnectorName) -> str:
    """``inner.first.x``."""
    return f"{node[0]}.{node[1]}" if node[0] else node[1]
