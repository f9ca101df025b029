"""The connections of an SSP file's FMUs, and their start values.

The source of each connector's signal is found through systems within systems. A system's own connector passes on the values from
outside (inputs, parameters) or from inside (outputs). Along the path values are converted between units, then transformed, connection
by connection (SSP 1.0: elements Connection and LinearTransformation). Start values come from parameter sets, by name or through
connectors.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from flexfmu.cosim.engine.errors import InputError, suggestion
from flexfmu.cosim.engine.fmu.file import UnpackedFmu
from flexfmu.cosim.engine.fmu.variables import Value, items
from flexfmu.cosim.engine.master.system import IDENTITY, LinearMap, SignalMap, TableMap, Wire
from flexfmu.cosim.engine.slave import TAKES, Type
from flexfmu.cosim.exchange.ssp.archive import SspError
from flexfmu.cosim.exchange.ssp.structure import (
    BASE_UNITS,
    NUMBERS,
    Binding,
    Component,
    Connector,
    MappingEntry,
    SspConnection,
    SspParameter,
    SspUnit,
    Structure,
    Subsystem,
    ValueMap,
    levels,
)

_DIMENSIONLESS = ("", "1")

_UNCHANGEABLE = "{} is {!r}, which a linear transformation can't change; give its value"

ConnectorName = tuple[str, str]
"""Full name of an element (``inner.first``; empty for the whole system) and its connector."""

_TAKERS, _GIVERS = ("input", "parameter"), ("output", "calculatedParameter")
"""Kinds of connectors that are targets and sources of connections. For the system's own connectors, seen from inside, the roles
are exchanged."""


@dataclass(frozen=True)
class ComponentFmu:
    """A component with its FMU.

    Attributes:
        component: its description in the SSD.
        fmu: the FMU.
    """

    component: Component
    fmu: UnpackedFmu

    @cached_property
    def variables(self) -> Mapping[str, Any]:
        """Name → variable as fmpy reads it."""
        return {variable.name: variable for variable in self.fmu.description.modelVariables}

    @cached_property
    def units(self) -> Mapping[str, SspUnit]:
        """Name → unit as the FMU defines it."""
        found = {}
        for each in self.fmu.description.unitDefinitions or ():
            if (base := each.baseUnit) is not None:
                exponents = {name: int(exponent) for name in BASE_UNITS if (exponent := getattr(base, name, 0))}
                found[each.name] = SspUnit(each.name, exponents, float(base.factor or 1.0), float(base.offset or 0.0))
        return found

    def type(self, name: str) -> Type:
        """Type of a variable, by its name in FMI 2.0."""
        found: Type = self.variables[name].type
        return NUMBERS.get(found, found)

    def items(self, name: str) -> Mapping[str, int]:
        """Return item name → number of an enumeration; empty for other types."""
        return items(self.variables[name])

    def unit(self, name: str) -> SspUnit | str:
        """Unit of a variable; its bare name where the FMU doesn't define it, empty where it has none."""
        variable = self.variables[name]
        text = variable.unit or (variable.declaredType.unit if variable.declaredType else None) or ""
        return self.units.get(text) or text

    def connector_unit(self, connector: Connector, units: Mapping[str, SspUnit]) -> SspUnit | str:
        """Unit of a connector: from the SSD, else from the FMU; its bare name where it isn't defined."""
        if connector.unit is None:
            return self.unit(connector.name)
        return units.get(connector.unit) or self.units.get(connector.unit) or connector.unit


def check_connectors(owner: ComponentFmu, connected: Collection[str], units: Mapping[str, SspUnit]) -> list[str]:
    """Check direction, type and unit of a component's connectors against its FMU; a remark on those that aren't connected.

    Raises:
        SspError: a connected one has no variable, or contradicts it.
    """
    problems: dict[str, str] = {}
    file = owner.component.source
    for each in owner.component.connectors:
        name, variable, problem = each.name, owner.variables.get(each.name), ""
        if variable is None:
            there = [other.name for other in owner.variables.values() if other.causality == each.kind]
            problem = f": {file} has no variable {name!r}; {suggestion(name, there)}"
        elif variable.causality != each.kind:
            problem = f" is of kind {each.kind}; in {file} it is {variable.causality}"
        elif each.type is not None and each.type != owner.type(name):
            problem = f" is {each.type}; in {file} it is {variable.type}"
        else:
            said, own = owner.connector_unit(each, units), owner.unit(name)
            if isinstance(said, SspUnit) and isinstance(own, SspUnit) and said.to(own) != IDENTITY:
                problem = f" is in {said.name}; in {file} it is in {own.name}; take the FMU's unit"
        # an error only for connected ones
        if problem and name in connected:
            raise SspError(each.where + problem)
        if problem:
            problems[name] = each.where + problem
    if not problems:
        return []
    first, others = next(iter(problems.values())), [*problems][1:]
    return [f"unconnected, ignored: {first}" + (f"; so are {', '.join(others)}" if others else "")]


def conversion(source: SspUnit | str, target: SspUnit | str, where: str, remarks: list[str]) -> LinearMap:
    """Return the conversion between two units; the identity, with a remark, if one of them is undefined.

    Raises:
        SspError: the units are of different quantities.
    """
    # nothing to convert
    names = [each if isinstance(each, str) else each.name for each in (source, target)]
    if names[0] == names[1] or any(name in _DIMENSIONLESS for name in names):
        return IDENTITY
    if isinstance(source, str) or isinstance(target, str):
        unknown = source if isinstance(source, str) else target
        remarks.append(f"{where}: the unit {unknown!r} isn't defined, so values aren't converted; define it in <Units>")
        return IDENTITY
    # both are defined, so they must measure the same quantity
    found = source.to(target)
    if found is None:
        raise SspError(
            f"{where}: {names[0]} can't be converted to {names[1]}; connect equal quantities, or set suppressUnitConversion"
        )
    return found


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
            self.connectors |= {(prefix[:-1], each.name): each for each in level.connectors}
            for component in level.components:
                self.connectors |= {(prefix + component.name, each.name): each for each in component.connectors}
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
            return self._fmus[node[0]].connector_unit(connector, self.units)
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


def start_values(
    structure: Structure, fmus: Mapping[str, ComponentFmu], network: Network
) -> tuple[Mapping[str, Mapping[str, Value]], tuple[str, ...]]:
    """Return the start values after all parameter bindings.

    Bindings of outer systems take precedence over those of inner elements, later bindings over earlier ones. Values of systems'
    connectors propagate along their connections.

    Args:
        structure: the system.
        fmus: full name of a component → the component with its FMU.
        network: its connections; remarks are added to it.

    Returns:
        Name of a component → its variables' start values; and the parameters that match no variable, which the standard allows.

    Raises:
        SspError: a value has the wrong type or unit, or its variable can't be set.
    """
    values: dict[str, dict[str, Value]] = {name: {} for name in fmus}
    connector_values: dict[ConnectorName, tuple[SspParameter, str]] = {}
    ignored: list[str] = []
    # values by name, to FMUs or to systems' connectors
    for binding, names in _levels(structure, fmus, network):
        network.remarks += binding.values.remarks
        units = {unit.name: unit for unit in binding.values.units}
        for parameter, entry in _used(binding):
            if entry.target not in names:
                ignored.append(entry.target)
                continue
            element, variable = node = names[entry.target]
            # convert to the unit of the target: units of the set, of the FMU, of the structure, in this order
            where = f"{binding.where}: parameter {parameter.name!r}"
            known = {**network.units, **(fmus[element].units if element in fmus else {}), **units}
            unit = fmus[element].unit(variable) if element in fmus else network.unit(node)
            source = unit if parameter.unit is None else known.get(parameter.unit, parameter.unit)
            convert = conversion(source, unit, where, network.remarks) if entry.converts_units else IDENTITY
            changed = replace(parameter, value=_transformed(parameter.value, entry, convert, where))
            if element in fmus:
                values[element][variable] = _value(changed, fmus[element], variable, where)
            else:
                connector_values[node] = changed, where
                network.value_units[node] = source
    # values of systems' connectors propagate along the connections to FMUs
    for node in network.feeds:
        origin = network.origin(node, connector_values) if node[0] in fmus else None
        if origin is not None and origin.node in connector_values:
            parameter, where = connector_values[origin.node]
            if origin.way != IDENTITY:
                if isinstance(parameter.value, str):
                    raise SspError(_UNCHANGEABLE.format(where, parameter.value))
                try:
                    parameter = replace(parameter, value=origin.way(float(parameter.value)))
                except InputError as error:
                    raise SspError(f"{where}: {error}") from error
            values[node[0]][node[1]] = _value(parameter, fmus[node[0]], node[1], where)
    return values, tuple(dict.fromkeys(ignored))


def _levels(
    structure: Structure, fmus: Mapping[str, ComponentFmu], network: Network
) -> Iterator[tuple[Binding, Mapping[str, ConnectorName]]]:
    """Yield all bindings in the order of application, each with name → variable for the names in its scope."""
    # hierarchical names of all variables and of systems' connectors
    nodes = {f"{element}.{name}": (element, name) for element, fmu in fmus.items() for name in fmu.variables}
    nodes |= {f"{node[0]}.{node[1]}".lstrip("."): node for node in network.connectors if node[0] not in fmus}
    for prefix, level in reversed([*levels(structure)]):
        for component in level.components:
            own = {name: (prefix + component.name, name) for name in fmus[prefix + component.name].variables}
            yield from ((binding, own) for binding in component.bindings)
    for prefix, level in reversed([*levels(structure)]):
        if level.bindings:
            inside = {name.removeprefix(prefix): node for name, node in nodes.items() if name.startswith(prefix)}
            yield from ((binding, inside) for binding in level.bindings)


def _used(binding: Binding) -> Sequence[tuple[SspParameter, MappingEntry]]:
    """Return the parameters of a binding that are used, each with its mapping entry."""
    named = [replace(each, name=binding.prefix + each.name) for each in binding.values.parameters]
    if binding.mapping is None:
        return [(each, MappingEntry(each.name, each.name)) for each in named]
    known = {each.name: each for each in named}
    return [(known[entry.source], entry) for entry in binding.mapping if entry.source in known]


def _transformed(value: Value, entry: MappingEntry, convert: LinearMap, where: str) -> Value:
    """The value, converted and transformed.

    Raises:
        SspError: it is no number, or not in the table.
    """
    transformation = entry.transformation
    if isinstance(transformation, ValueMap):
        # a table knows only its own entries
        table = dict(transformation.pairs)
        if value not in table:
            raise SspError(f"{where} is {value!r}, which its mapping doesn't have; add it")
        return table[value]
    linear = convert.then(transformation)
    if linear == IDENTITY:
        return value
    if isinstance(value, (bool, str)):
        raise SspError(_UNCHANGEABLE.format(where, value))
    return linear(value)


def _value(parameter: SspParameter, fmu: ComponentFmu, name: str, where: str) -> Value:
    """The value in the variable's type.

    Raises:
        SspError: its type is wrong, or the FMU calculates the variable.
    """
    variable, kind, value = fmu.variables[name], fmu.type(name), parameter.value
    if variable.initial not in ("exact", "approx") and variable.causality != "input":
        raise SspError(f"{where} sets {name!r} of {fmu.component.source}, which the FMU calculates; leave it out")
    if kind in ("Integer", "Enumeration") and isinstance(value, float) and value.is_integer():
        return int(value)
    allowed = {"Real": ("Real", "Integer"), "Enumeration": ("Enumeration", "Integer")}
    if parameter.type not in allowed.get(kind, (kind,)):
        raise SspError(f"{where} is {parameter.type}; {name!r} of {fmu.component.source} is {variable.type}")
    return float(value) if kind == "Real" else value
