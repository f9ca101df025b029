"""Start values of FMU variables from the parameter sets of a system, by name or through connectors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.master.linear_map import IDENTITY, LinearMap
from flexfmu.cosim.exchange.ssp.structure import (
    Binding,
    MappingEntry,
    SspError,
    SspParameter,
    Structure,
    ValueMap,
    levels,
)
from flexfmu.cosim.exchange.ssp.variables import ComponentFmu, conversion, variable_unit
from flexfmu.cosim.exchange.ssp.wiring import ConnectorName, Network, Origin


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
            unit = variable_unit(fmus[element], variable) if element in fmus else network.unit(node)
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
                parameter = replace(parameter, value=_along(origin, _number(parameter, where), where))
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
        raise SspError(f"{where} is {value!r}, which a linear transformation can't change; give its value")
    return linear(value)


def _along(origin: Origin, value: float, where: str) -> float:
    """Return the value after the transformations on its path.

    Raises:
        SspError: a table on the path has no entry for it.
    """
    try:
        return origin.way(value)
    except InputError as error:
        raise SspError(f"{where}: {error}") from error


def _number(parameter: SspParameter, where: str) -> float:
    """The value, which has to be a number.

    Raises:
        SspError: it is none.
    """
    if isinstance(parameter.value, str):
        raise SspError(f"{where} is {parameter.value!r}, which a linear transformation can't change; give its value")
    return float(parameter.value)


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
