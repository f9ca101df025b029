"""Parameter sets (SSV), mappings (SSM) and the bindings that apply them."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast, get_args

from flexfmu.cosim.fmu.variables import Value
from flexfmu.cosim.master.linear_map import IDENTITY, LinearMap
from flexfmu.cosim.ssp.archive import DESCRIPTION, SspArchive
from flexfmu.cosim.ssp.structure import Binding, MappingEntry, Parameter, ParameterSet, Type, Unit
from flexfmu.cosim.ssp.xml_tree import Node, parse

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

PARAMETER_SET, PARAMETER_MAPPING = "application/x-ssp-parameter-set", "application/x-ssp-parameter-mapping"

_TRANSFORMATIONS = ("BooleanMappingTransformation", "IntegerMappingTransformation", "EnumerationMappingTransformation")


def read_bindings(element: Node, archive: SspArchive, component: str | None = None) -> tuple[Binding, ...]:
    """The parameter bindings of a component or system.

    Args:
        element: the component or system.
        archive: where external sets are.
        component: path of the component's FMU; None for a system.

    Raises:
        SspError: a set is missing, broken, or of another kind.
    """
    found = element.children("ParameterBindings", "ParameterBinding")
    return tuple(_binding(each, archive, component) for each in found)


def read_units(nodes: Node) -> tuple[Unit, ...]:
    """The units that a file defines."""
    return tuple(_unit(each) for each in nodes.children("Units", "Unit"))


def read_transformation(node: Node) -> LinearMap:
    """The linear map of a connection or mapping entry.

    Raises:
        SspError: it has a transformation of another kind, or one that makes no sense.
    """
    for name in _TRANSFORMATIONS:
        if (other := node.child(name)) is not None:
            raise other.error("is not supported, only LinearTransformation is; map the values inside an FMU")
    linear = node.child("LinearTransformation")
    if linear is None:
        return IDENTITY
    factor, offset = linear.number("factor"), linear.number("offset")
    return LinearMap(1.0 if factor is None else factor, 0.0 if offset is None else offset)


def _binding(node: Node, archive: SspArchive, component: str | None) -> Binding:
    """One parameter binding."""
    if node.text("type") not in (None, "", PARAMETER_SET):
        raise node.error(f"has the type {node.text('type')!r}; only {PARAMETER_SET} can be read")
    source = _source(node, archive, component)
    root = _external(archive, source, node, "ParameterSet") if source else node.child("ParameterValues", "ParameterSet")
    if root is None:
        raise node.error("has neither a source nor a ParameterSet within; add one of them")
    mapping = node.child("ParameterMapping")
    entries = None if mapping is None else _mapping(mapping, archive, component)
    return Binding(_parameter_set(root), node.text("prefix") or "", entries, source, node.where)


def _source(node: Node, archive: SspArchive, component: str | None) -> str | None:
    """Path within the archive of an external file, None where the content is in the SSD."""
    source = node.text("source")
    if not source:
        return None
    base = node.text("sourceBase") or "SSD"
    if base not in ("SSD", "component"):
        raise node.error(f"has sourceBase={base!r}, which must be SSD or component")
    if base == "component":
        raise node.error("takes its source from within an FMU (sourceBase='component'); put the file beside the FMU")
    return archive.resolve(source, node.where, DESCRIPTION)


def _external(archive: SspArchive, file: str, asking: Node, root: str) -> Node:
    """The root of an external file."""
    return parse(archive.read(file, asking.where), archive.label(file), root)


def _mapping(node: Node, archive: SspArchive, component: str | None) -> tuple[MappingEntry, ...]:
    """A mapping, external or not."""
    if node.text("type") not in (None, "", PARAMETER_MAPPING):
        raise node.error(f"has the type {node.text('type')!r}; only {PARAMETER_MAPPING} can be read")
    source = _source(node, archive, component)
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
    )


def _parameter_set(root: Node) -> ParameterSet:
    """A parameter set.

    Raises:
        SspError: a parameter is given twice or has no value.
    """
    parameters = tuple(_parameter(each) for each in root.children("Parameters", "Parameter"))
    names = [each.name for each in parameters]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise root.error(f"has the parameter {twice!r} twice; keep one")
    return ParameterSet(root.required("name"), parameters, read_units(root))


def _parameter(node: Node) -> Parameter:
    """One parameter with its typed value."""
    value = next((each for each in node.children("*") if each.tag in _READ or each.tag == "Binary"), None)
    if value is None:
        raise node.error(f"has no value; give it one of {', '.join(get_args(Type))}")
    if value.tag == "Binary":
        raise node.error("is Binary, which FMI 2.0 doesn't have; leave it out")
    found = _READ[value.tag](value)
    if found is None:
        raise value.error("lacks the attribute 'value'; add it")
    return Parameter(node.required("name"), cast(Type, value.tag), found, value.text("unit"))


_READ: dict[str, Callable[[Node], Value | None]] = {
    "Real": lambda node: node.number("value"),
    "Integer": lambda node: node.integer("value"),
    "Boolean": lambda node: None if node.text("value") is None else node.boolean("value"),
    "String": lambda node: node.text("value"),
    "Enumeration": lambda node: node.text("value"),
}
"""Type → how its value is read."""


def _unit(node: Node) -> Unit:
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
    return Unit(node.required("name"), exponents, 1.0 if factor is None else factor, offset or 0.0)
