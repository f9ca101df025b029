"""From a system structure's connections to the master's: direction, existence, types and units."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches

from flexfmu.cosim.master.linear_map import IDENTITY
from flexfmu.cosim.master.system import Wire
from flexfmu.cosim.ssp.structure import Connection, Connector, SspError, Structure, Unit
from flexfmu.cosim.ssp.variables import ComponentFmu, conversion, unit_of

_TYPES = {
    "Real": ("Real", "Integer"),
    "Integer": ("Integer",),
    "Boolean": ("Boolean",),
    "Enumeration": ("Enumeration",),
}
"""Type of an input → types of outputs that may feed it."""


def wires(structure: Structure, fmus: Mapping[str, ComponentFmu], names: Mapping[str, str]) -> list[Wire]:
    """Connections between components; what the system's own connectors are connected to stays at its start value.

    Args:
        structure: the system.
        fmus: name of a component → the component with its FMU.
        names: name of a component → name of its slave.

    Raises:
        SspError: an end doesn't exist, leads the wrong way, or types or units don't fit.
    """
    units = {unit.name: unit for unit in structure.units}
    inner = [each for each in structure.connections if _is_inner(each, structure)]
    return [_wire(each, fmus, names, units) for each in inner]


def _is_inner(connection: Connection, structure: Structure) -> bool:
    """Whether both ends are on components.

    Raises:
        SspError: the system has no connector of that name.
    """
    own = [connector for element, connector in (connection.start, connection.end) if element is None]
    known = [each.name for each in structure.connectors]
    for name in own:
        if name not in known:
            raise SspError(
                f"{connection.where} names the system's connector {name!r}, which doesn't exist{_hint(name, known)}"
            )
    return not own


def _wire(
    connection: Connection, fmus: Mapping[str, ComponentFmu], names: Mapping[str, str], units: Mapping[str, Unit]
) -> Wire:
    """One connection, from output to input."""
    ends = [_end(connection, element or "", name, fmus) for element, name in (connection.start, connection.end)]
    kinds = [connector.kind for _, connector in ends]
    if sorted(kinds) != ["input", "output"]:
        remedy = "set the parameter with a parameter set" if "parameter" in kinds else "connect an output and an input"
        raise SspError(f"{connection.where} joins {kinds[0]} and {kinds[1]}; {remedy}")
    (giver, output), (taker, receiver) = ends if kinds[0] == "output" else reversed(ends)
    types = giver.variables[output.name].type, taker.variables[receiver.name].type
    if types[0] not in _TYPES.get(types[1], ()):
        raise SspError(
            f"{connection.where} feeds {types[1]} {receiver.name!r} from {types[0]} {output.name!r}; convert in an FMU"
        )
    source, target = unit_of(output, giver, units), unit_of(receiver, taker, units)
    where = f"{connection.where} from {output.name!r} to {receiver.name!r}"
    convert = conversion(source, target, where) if connection.converts_units else IDENTITY
    linear = convert.then(connection.transformation)
    return f"{names[giver.component.name]}.{output.name}", f"{names[taker.component.name]}.{receiver.name}", linear


def _end(
    connection: Connection, element: str, name: str, fmus: Mapping[str, ComponentFmu]
) -> tuple[ComponentFmu, Connector]:
    """The connector that an end names.

    Raises:
        SspError: there is none.
    """
    if element not in fmus:
        raise SspError(
            f"{connection.where} names the element {element!r}, which doesn't exist{_hint(element, [*fmus])}"
        )
    connectors = {each.name: each for each in fmus[element].component.connectors}
    if name not in connectors:
        raise SspError(
            f"{connection.where} names the connector {name!r}, which {element!r} doesn't have{_hint(name, [*connectors])}"
        )
    return fmus[element], connectors[name]


def _hint(name: str, known: list[str]) -> str:
    """What may be meant."""
    near = get_close_matches(name, known, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; there are: {', '.join(known) or 'none'}"
