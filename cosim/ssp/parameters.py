"""Which values the parameter sets of a system give to the variables of its FMUs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from flexfmu.cosim.fmu.variables import Value
from flexfmu.cosim.master.linear_map import IDENTITY
from flexfmu.cosim.ssp.structure import Binding, MappingEntry, Parameter, SspError, Structure, Unit
from flexfmu.cosim.ssp.variables import ComponentFmu, conversion, variable_unit

Target = tuple[str, str]
"""Names of a component and of its variable."""


@dataclass(frozen=True)
class StartValues:
    """Values for all components.

    Attributes:
        values: name of a component → its variables' start values.
        ignored: parameters that fit no variable, which the standard lets pass.
    """

    values: Mapping[str, Mapping[str, Value]]
    ignored: tuple[str, ...]


def start_values(structure: Structure, fmus: Mapping[str, ComponentFmu]) -> StartValues:
    """Apply all bindings: those of components first, then the system's, which outrank them; later ones outrank earlier.

    Raises:
        SspError: a value doesn't suit its variable's type or unit, or comes from one that can't be set.
    """
    values: dict[str, dict[str, Value]] = {name: {} for name in fmus}
    ignored: list[str] = []
    for binding, names in _levels(structure, fmus):
        for parameter, entry in _used(binding):
            if entry.target not in names:
                ignored.append(entry.target)
                continue
            component, variable = names[entry.target]
            values[component][variable] = _value(parameter, entry, fmus[component], variable, binding)
    return StartValues(values, tuple(dict.fromkeys(ignored)))


def _levels(structure: Structure, fmus: Mapping[str, ComponentFmu]) -> Iterator[tuple[Binding, Mapping[str, Target]]]:
    """All bindings in the order in which they are applied, with the names that they may use."""
    for component in structure.components:
        own = {name: (component.name, name) for name in fmus[component.name].variables}
        yield from ((binding, own) for binding in component.bindings)
    everything = {f"{component}.{name}": (component, name) for component, fmu in fmus.items() for name in fmu.variables}
    yield from ((binding, {**everything, **_exposed(structure)}) for binding in structure.bindings)


def _exposed(structure: Structure) -> dict[str, Target]:
    """Variables that the system shows under the names of its own connectors."""
    inner = {each.name for each in structure.connectors if each.kind in ("input", "parameter")}
    ends = [pair for each in structure.connections for pair in ((each.start, each.end), (each.end, each.start))]
    return {name: (element, variable) for (outer, name), (element, variable) in ends
            if outer is None and name in inner and element is not None}  # fmt: skip


def _used(binding: Binding) -> Sequence[tuple[Parameter, MappingEntry]]:
    """The values of a set that count, each with its target."""
    named = [replace(each, name=binding.prefix + each.name) for each in binding.values.parameters]
    if binding.mapping is None:
        return [(each, MappingEntry(each.name, each.name)) for each in named]
    known = {each.name: each for each in named}
    return [(known[entry.source], entry) for entry in binding.mapping if entry.source in known]


def _value(parameter: Parameter, entry: MappingEntry, fmu: ComponentFmu, name: str, binding: Binding) -> Value:
    """The value in the variable's type and unit."""
    variable, where = fmu.variables[name], f"{binding.where}: parameter {parameter.name!r}"
    if variable.initial not in ("exact", "approx") and variable.causality != "input":
        raise SspError(f"{where} sets {name!r} of {fmu.component.source}, which the FMU calculates; leave it out")
    allowed = {"Real": ("Real", "Integer"), "Enumeration": ("Enumeration", "Integer")}
    if parameter.type not in allowed.get(variable.type, (variable.type,)):
        raise SspError(f"{where} is {parameter.type}; {name!r} of {fmu.component.source} is {variable.type}")
    if variable.type != "Real":
        if entry.transformation != IDENTITY:
            raise SspError(f"{where} is transformed, but {name!r} of {fmu.component.source} is no Real; give its value")
        return parameter.value
    units: dict[str, Unit] = {unit.name: unit for unit in binding.values.units}
    target = variable_unit(fmu, name)
    source = (
        target if parameter.unit is None else units.get(parameter.unit, fmu.units.get(parameter.unit, parameter.unit))
    )
    convert = conversion(source, target, where) if entry.converts_units else IDENTITY
    return convert.then(entry.transformation)(float(parameter.value))
