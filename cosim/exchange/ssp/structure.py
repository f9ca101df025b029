"""A system structure description (SSD) as data, without XML and without FMUs.

Names follow SSP 1.0 (Modelica Association, 2019); of SSP 2.0 there is what 1.0 has.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isclose
from typing import Literal

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.master.linear_map import IDENTITY, LinearMap
from flexfmu.cosim.engine.slave import Type

ConnectorKind = Literal["input", "output", "parameter", "calculatedParameter", "inout"]


class SspError(InputError):
    """A file isn't SSP, contradicts the standard, or needs a feature that this program doesn't have."""


@dataclass(frozen=True)
class SspUnit:
    """A unit: value in SI base units = factor * value + offset.

    Attributes:
        name: its spelling.
        exponents: base unit → exponent, zeros left out.
        factor, offset: see above.
    """

    name: str
    exponents: Mapping[str, int]
    factor: float = 1.0
    offset: float = 0.0

    def to(self, other: SspUnit) -> LinearMap | None:
        """Return the conversion to another unit; None for a unit of another quantity."""
        if dict(self.exponents) != dict(other.exponents):
            return None
        if isclose(self.factor, other.factor, rel_tol=1e-15) and self.offset == other.offset:
            return IDENTITY
        return LinearMap(self.factor / other.factor, (self.offset - other.offset) / other.factor)


@dataclass(frozen=True)
class ValueMap:
    """A table from values to values: booleans, integers, or names of enumerations' items."""

    pairs: tuple[tuple[Value, Value], ...]

    def linear(self) -> LinearMap | None:
        """Return the linear map through all pairs (false 0, true 1); None if there is none."""
        if not self.pairs or any(isinstance(each, str) for pair in self.pairs for each in pair):
            return None
        points = dict.fromkeys((float(x), float(y)) for x, y in self.pairs)
        (x0, y0), (x1, y1) = min(points), max(points)
        slope = 0.0 if x0 == x1 else (y1 - y0) / (x1 - x0)
        fits = all(y0 + slope * (x - x0) == y for x, y in points)
        return LinearMap(slope, y0 - slope * x0) if fits else None


SspTransformation = LinearMap | ValueMap


@dataclass(frozen=True)
class Connector:
    """A variable of an element that connections may use.

    Attributes:
        name: name of the variable.
        kind: direction.
        type: its type; None for that of the FMU's variable.
        unit: its unit; None for that of the FMU's variable.
        where: file and line, for errors.
    """

    name: str
    kind: ConnectorKind
    type: Type | Literal["Binary"] | None = None
    unit: str | None = None
    where: str = ""


@dataclass(frozen=True)
class SspConnection:
    """A signal path. Start and end say nothing about its direction; the connectors' kinds do.

    Attributes:
        start, end: (element, connector); element None for connectors of the system itself.
        transformation: from source to target.
        converts_units: whether units are converted before.
        where: file and line, for errors.
    """

    start: tuple[str | None, str]
    end: tuple[str | None, str]
    transformation: SspTransformation = IDENTITY
    converts_units: bool = True
    where: str = ""


@dataclass(frozen=True)
class SspParameter:
    """A value for a variable.

    Attributes:
        name: name of the variable, hierarchical where the set is bound to a system.
        type: type of the value.
        value: the value; the item's name for an enumeration.
        unit: its unit; None for that of the variable.
    """

    name: str
    type: Type
    value: Value
    unit: str | None = None


@dataclass(frozen=True)
class ParameterSet:
    """Values with the units that they use, and remarks on what was wrong with the file."""

    name: str
    parameters: tuple[SspParameter, ...]
    units: tuple[SspUnit, ...] = ()
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class MappingEntry:
    """The variable that gets a value of a parameter set, and the transformation in between."""

    source: str
    target: str
    transformation: SspTransformation = IDENTITY
    converts_units: bool = True


@dataclass(frozen=True)
class Binding:
    """A parameter set applied to an element.

    Attributes:
        values: the parameter set.
        prefix: prefix of all names in the set.
        mapping: entries for the values that are used; None to use all under their own names.
        source: file of the set within the archive; None for a set within the SSD.
        where: file and line, for errors.
    """

    values: ParameterSet
    prefix: str = ""
    mapping: tuple[MappingEntry, ...] | None = None
    source: str | None = None
    where: str = ""


@dataclass(frozen=True)
class Component:
    """An FMU in the system.

    Attributes:
        name: name of the element.
        source: path of the FMU within the archive.
        connectors: its variables that are connected.
        bindings: its parameter sets; later ones take precedence.
        description: what it is.
        where: file and line, for errors.
        sampling: sample time and offset [s] of an FMU that doesn't state them itself; None where the file doesn't say.
        implementation: kind of FMU that the file asks for.
    """

    name: str
    source: str
    connectors: tuple[Connector, ...]
    bindings: tuple[Binding, ...] = ()
    description: str = ""
    where: str = ""
    sampling: tuple[float, float] | None = None
    implementation: str = "CoSimulation"


@dataclass(frozen=True)
class Subsystem:
    """A system: that of the file, or one within another.

    Attributes:
        name: name of the element.
        components: its FMUs.
        connections: the signal paths between its elements.
        connectors: the system's own connectors.
        bindings: parameter sets of the system, which outrank those of its elements.
        systems: systems within it.
        where: file and line, for errors.
    """

    name: str
    components: tuple[Component, ...]
    connections: tuple[SspConnection, ...] = ()
    connectors: tuple[Connector, ...] = ()
    bindings: tuple[Binding, ...] = ()
    systems: tuple[Subsystem, ...] = ()
    where: str = ""


@dataclass(frozen=True)
class Structure(Subsystem):
    """A whole file: the outermost system under the name of the file.

    Attributes:
        units: units that connectors refer to.
        start, stop: default experiment [s]; None where the file doesn't say.
        step: communication step [s]; None where the file doesn't say.
        tolerance: relative tolerance for the FMUs; None where the file doesn't say.
        description: what it is.
    """

    units: tuple[SspUnit, ...] = ()
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    tolerance: float | None = None
    description: str = ""


def levels(structure: Structure) -> Iterator[tuple[str, Subsystem]]:
    """Yield the system and all subsystems, outer ones first, each with the prefix of its elements' names, such as ``inner.``."""
    waiting: list[tuple[str, Subsystem]] = [("", structure)]
    while waiting:
        prefix, level = waiting.pop(0)
        yield prefix, level
        waiting += [(f"{prefix}{each.name}.", each) for each in level.systems]
