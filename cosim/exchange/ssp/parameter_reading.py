"""Parameter sets (SSV), mappings (SSM) and the bindings that apply them, read from XML."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast, get_args

from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.master.linear_map import IDENTITY, LinearMap
from flexfmu.cosim.engine.slave import Type
from flexfmu.cosim.exchange.ssp.archive import SspArchive
from flexfmu.cosim.exchange.ssp.structure import (
    Binding,
    MappingEntry,
    ParameterSet,
    SspParameter,
    SspTransformation,
    SspUnit,
    ValueMap,
)
from flexfmu.cosim.exchange.ssp.xml_tree import XmlElement, parse

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

PARAMETER_SET, PARAMETER_MAPPING = "application/x-ssp-parameter-set", "application/x-ssp-parameter-mapping"

NUMBERS: dict[str, Type] = {
    **dict.fromkeys(("Float32", "Float64"), "Real"),
    **dict.fromkeys(("Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"), "Integer"),
}
"""Types of numbers in SSP 2.0 and FMI 3.0 → those of SSP 1.0 and FMI 2.0."""


def read_bindings(element: XmlElement, archive: SspArchive) -> tuple[Binding, ...]:
    """The parameter bindings of a component or system.

    Args:
        element: the component or system.
        archive: where external sets are.

    Raises:
        SspError: a set is missing, broken, or of another kind.
    """
    return tuple(_binding(each, archive) for each in element.children("ParameterBindings", "ParameterBinding"))


def read_units(nodes: XmlElement) -> tuple[SspUnit, ...]:
    """The units that a file defines."""
    return tuple(_unit(each) for each in nodes.children("Units", "Unit"))


def read_transformation(node: XmlElement) -> SspTransformation:
    """The transformation of a connection or mapping entry.

    Raises:
        SspError: an attribute is missing or invalid.
    """
    for kind in ("Boolean", "Integer", "Enumeration"):
        if (table := node.child(f"{kind}MappingTransformation")) is not None:
            return ValueMap(tuple(_pair(each, kind) for each in table.children("MapEntry")))
    linear = node.child("LinearTransformation")
    if linear is None:
        return IDENTITY
    factor, offset = linear.number("factor"), linear.number("offset")
    return LinearMap(1.0 if factor is None else factor, 0.0 if offset is None else offset)


def _pair(node: XmlElement, kind: str) -> tuple[Value, Value]:
    """Source and target of a table's entry."""
    source, target = (_READ[kind](node, each) for each in ("source", "target"))
    if source is None or target is None:
        raise node.error("needs the attributes 'source' and 'target'; add them")
    return source, target


def _binding(node: XmlElement, archive: SspArchive) -> Binding:
    """One parameter binding."""
    if node.text("type") not in (None, "", PARAMETER_SET):
        raise node.error(f"has the type {node.text('type')!r}; only {PARAMETER_SET} can be read")
    source = _source(node, archive)
    root = _external(archive, source, node, "ParameterSet") if source else node.child("ParameterValues", "ParameterSet")
    if root is None:
        raise node.error("has neither a source nor a ParameterSet within; add one of them")
    mapping = node.child("ParameterMapping")
    entries = None if mapping is None else _mapping(mapping, archive)
    return Binding(_parameter_set(root), node.text("prefix") or "", entries, source, node.where)


def _source(node: XmlElement, archive: SspArchive) -> str | None:
    """Path within the archive of an external file, None where the content is in the SSD."""
    source = node.text("source")
    if not source:
        return None
    base = node.text("sourceBase") or "SSD"
    if base not in ("SSD", "component"):
        raise node.error(f"has sourceBase={base!r}, which must be SSD or component")
    if base == "component":
        raise node.error("takes its source from within an FMU (sourceBase='component'); put the file beside the FMU")
    return archive.resolve(source, node.where)


def _external(archive: SspArchive, file: str, asking: XmlElement, root: str) -> XmlElement:
    """The root of an external file."""
    return parse(archive.read(file, asking.where), archive.label(file), root)


def _mapping(node: XmlElement, archive: SspArchive) -> tuple[MappingEntry, ...]:
    """A mapping, external or not."""
    if node.text("type") not in (None, "", PARAMETER_MAPPING):
        raise node.error(f"has the type {node.text('type')!r}; only {PARAMETER_MAPPING} can be read")
    source = _source(node, archive)
    root = _external(archive, source, node, "ParameterMapping") if source else node.child("ParameterMapping")
    if root is None:
        raise node.error("has neither a source nor a mapping within; add one of them")
    return tuple(
        MappingEntry(
            each.required("source"),
            each.required("target"),
            read_transformation(each),
            not each.boolean("suppressUnitConversion"),
        )
        for each in root.children("MappingEntry")
        if each.text("source") != ""  # an empty entry of a template
    )


def _parameter_set(root: XmlElement) -> ParameterSet:
    """Return a parameter set; for a repeated name the last value counts.

    Raises:
        SspError: a parameter has no value.
    """
    found: dict[str, SspParameter] = {}
    repeated: list[str] = []
    for each in map(_parameter, root.children("Parameters", "Parameter")):
        if found.get(each.name, each) != each:
            repeated.append(f"{root.where} has the parameter {each.name!r} twice, {each.value!r} counts")
        found[each.name] = each
    return ParameterSet(root.required("name"), tuple(found.values()), read_units(root), tuple(repeated))


def _parameter(node: XmlElement) -> SspParameter:
    """One parameter with its typed value."""
    # the element with the value, which FMI 2.0 must know
    value = next((each for each in node.children("*") if each.tag in (*_READ, *NUMBERS, "Binary")), None)
    if value is None:
        raise node.error(f"has no value; give it one of {', '.join(get_args(Type))}")
    if value.tag == "Binary":
        raise node.error("is Binary, which FMI 2.0 doesn't have; leave it out")
    # its value in the type of FMI 2.0
    kind = NUMBERS.get(value.tag, cast(Type, value.tag))
    if len((value.text("value") or "").split()) > 1 and value.tag != kind:
        raise value.error("is an array of SSP 2.0, which this program doesn't read; give each element its own value")
    found = _READ[kind](value, "value")
    if found is None:
        raise value.error("lacks the attribute 'value'; add it")
    return SspParameter(node.required("name"), kind, found, value.text("unit"))


_READ: dict[str, Callable[[XmlElement, str], Value | None]] = {
    "Real": XmlElement.number,
    "Integer": XmlElement.integer,
    "Boolean": lambda node, attribute: None if node.text(attribute) is None else node.boolean(attribute),
    "String": XmlElement.text,
    "Enumeration": XmlElement.text,
}
"""Type → how the value of an attribute is read."""


def _unit(node: XmlElement) -> SspUnit:
    """One unit.

    Raises:
        SspError: it isn't defined, or its factor is zero.
    """
    base = node.child("BaseUnit")
    if base is None:
        raise node.error("has no BaseUnit; add it")
    exponents = {name: exponent for name in BASE_UNITS if (exponent := base.integer(name))}
    factor, offset = base.number("factor"), base.number("offset")
    if factor == 0.0:
        raise base.error("has factor='0', which no value can be converted with")
    return SspUnit(node.required("name"), exponents, 1.0 if factor is None else factor, offset or 0.0)
