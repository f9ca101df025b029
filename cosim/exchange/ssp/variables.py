"""Types and units of the FMU variables in a system, and unit conversions."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from flexfmu.cosim.engine.fmu.file import UnpackedFmu
from flexfmu.cosim.engine.fmu.variables import items
from flexfmu.cosim.engine.master.linear_map import IDENTITY, LinearMap
from flexfmu.cosim.engine.slave import Type
from flexfmu.cosim.exchange.ssp.reading import BASE_UNITS, NUMBERS
from flexfmu.cosim.exchange.ssp.structure import Component, Connector, SspError, SspUnit

_DIMENSIONLESS = ("", "1")


@dataclass(frozen=True)
class ComponentFmu:
    """A component with its FMU.

    Attributes:
        component: its description in the SSD.
        fmu: the FMU.
        variables: name → variable as fmpy reads it.
        units: name → unit as the FMU defines it.
    """

    component: Component
    fmu: UnpackedFmu
    variables: Mapping[str, Any]
    units: Mapping[str, SspUnit]

    def type(self, name: str) -> Type:
        """Type of a variable, by its name in FMI 2.0."""
        found: Type = self.variables[name].type
        return NUMBERS.get(found, found)

    def items(self, name: str) -> Mapping[str, int]:
        """Return item name → number of an enumeration; empty for other types."""
        return items(self.variables[name])


def component_fmu(component: Component, fmu: UnpackedFmu) -> ComponentFmu:
    """A component with the variables and units of its FMU."""
    variables = {variable.name: variable for variable in fmu.description.modelVariables}
    return ComponentFmu(component, fmu, variables, _fmu_units(fmu.description))


def check_connectors(owner: ComponentFmu, connected: Collection[str], units: Sequence[SspUnit]) -> list[str]:
    """Check a component's connectors against its FMU; remarks on those that fail and aren't connected.

    Raises:
        SspError: a connected one has no variable, or contradicts it.
    """
    known, problems = {unit.name: unit for unit in units}, {}
    # errors only for connected ones
    for connector in owner.component.connectors:
        try:
            _check(connector, owner, known)
        except SspError as error:
            if connector.name in connected:
                raise
            problems[connector.name] = str(error)
    if not problems:
        return []
    # one remark on all of them
    first, others = next(iter(problems.values())), [*problems][1:]
    return [f"unconnected, ignored: {first}" + (f"; so are {', '.join(others)}" if others else "")]


def unit_of(connector: Connector, owner: ComponentFmu, units: Mapping[str, SspUnit]) -> SspUnit | str:
    """Unit of a component's connector: from the SSD, else from the FMU; its bare name where it isn't defined."""
    if connector.unit is not None:
        return units.get(connector.unit) or owner.units.get(connector.unit) or connector.unit
    return variable_unit(owner, connector.name)


def variable_unit(owner: ComponentFmu, name: str) -> SspUnit | str:
    """Unit of an FMU's variable; its bare name where the FMU doesn't define it."""
    variable = owner.variables[name]
    text: str = variable.unit or (variable.declaredType.unit if variable.declaredType else None) or ""
    return owner.units.get(text) or text


def conversion(source: SspUnit | str, target: SspUnit | str, where: str, remarks: list[str]) -> LinearMap:
    """Return the conversion between two units; the identity, with a remark, if one of them is undefined.

    Raises:
        SspError: the units are of different quantities.
    """
    # nothing to convert
    names = [each if isinstance(each, str) else each.name for each in (source, target)]
    if names[0] == names[1] or any(name in _DIMENSIONLESS for name in names):
        return IDENTITY
    # an undefined unit can't be converted
    for each in (source, target):
        if isinstance(each, str):
            remarks.append(
                f"{where}: the unit {each!r} isn't defined, so values aren't converted; define it in <Units>"
            )
            return IDENTITY
    assert isinstance(source, SspUnit)
    assert isinstance(target, SspUnit)
    # both are defined, so they must measure the same quantity
    found = source.to(target)
    if found is None:
        raise SspError(
            f"{where}: {names[0]} can't be converted to {names[1]}; connect equal quantities, or set suppressUnitConversion"
        )
    return found


def missing(owner: ComponentFmu, connector: Connector | str, causality: str | None = None) -> str:
    """The error text for a variable that the FMU doesn't have, with the nearest name."""
    name = connector if isinstance(connector, str) else connector.name
    candidates = [n for n, v in owner.variables.items() if causality in (None, v.causality)]
    near = get_close_matches(name, candidates, n=1)
    return f"{owner.component.source} has no variable {name!r}" + (f"; did you mean {near[0]!r}?" if near else "")


def _check(connector: Connector, owner: ComponentFmu, units: Mapping[str, SspUnit]) -> None:
    """Check a connector against the FMU's variable: direction, type and unit.

    Raises:
        SspError: it doesn't.
    """
    variable = owner.variables.get(connector.name)
    if variable is None:
        raise SspError(f"{connector.where}: {missing(owner, connector, connector.kind)}")
    # direction, type and unit
    if variable.causality != connector.kind:
        raise SspError(
            f"{connector.where} is of kind {connector.kind}; in {owner.component.source} it is {variable.causality}"
        )
    if connector.type is not None and connector.type != owner.type(connector.name):
        raise SspError(f"{connector.where} is {connector.type}; in {owner.component.source} it is {variable.type}")
    said, own = unit_of(connector, owner, units), variable_unit(owner, connector.name)
    if isinstance(said, SspUnit) and isinstance(own, SspUnit) and said.to(own) != IDENTITY:
        raise SspError(
            f"{connector.where} is in {said.name}; in {owner.component.source} it is in {own.name}; take the FMU's unit"
        )


def _fmu_units(description: Any) -> Mapping[str, SspUnit]:
    """Units that an FMU defines."""
    return {each.name: _unit(each) for each in description.unitDefinitions or () if each.baseUnit is not None}


def _unit(definition: Any) -> SspUnit:
    """A unit of an FMU."""
    base = definition.baseUnit
    exponents = {name: int(exponent) for name in BASE_UNITS if (exponent := getattr(base, name, 0))}
    return SspUnit(definition.name, exponents, float(base.factor or 1.0), float(base.offset or 0.0))
