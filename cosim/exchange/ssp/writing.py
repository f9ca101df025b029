"""A structure as the XML of SSP 1.0; the same structure gives the same bytes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from lxml import etree

from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.master.linear_map import IDENTITY, LinearMap
from flexfmu.cosim.exchange.ssp.reading import ANNOTATION, BASE_UNITS, FMU, OMS_STEPS, OSP_STEP
from flexfmu.cosim.exchange.ssp.structure import (
    Binding,
    Component,
    Connector,
    ParameterSet,
    SspConnection,
    SspTransformation,
    SspUnit,
    Structure,
    Subsystem,
)
from flexfmu.cosim.exchange.ssp.xml_tree import NAMESPACES

VERSION = "1.0"

_NAMESPACES = {
    **NAMESPACES,
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
    "flexfmu": "urn:flexfmu:ssp",
}
"""Prefixes; some importers look for them literally, and libcosim takes declarations below the root for elements."""

OSP_ANNOTATION = "com.opensimulationplatform"
"""Type of the annotation with the communication step, as libcosim reads it."""

OMS_ANNOTATION = "org.openmodelica"
"""Type of the annotation with communication step and tolerance, as OMSimulator reads it."""


def ssd_xml(structure: Structure, tool: str) -> bytes:
    """Content of ``SystemStructure.ssd``.

    Args:
        structure: the system; parameter sets with a source are referred to, the others are written inline.
        tool: name of the program that wrote it.
    """
    root = etree.Element(_tag("ssd:SystemStructureDescription"), nsmap=_NAMESPACES)
    _set(root, version=VERSION, name=structure.name, description=structure.description, generationTool=tool)
    system = _add(root, "ssd:System", name=structure.name, description=structure.description)
    _system(system, structure)
    _master(system, structure)
    _units(root, "ssd:Units", structure.units)
    _experiment(root, structure)
    return _bytes(root)


def ssv_xml(values: ParameterSet, tool: str) -> bytes:
    """Content of an external parameter set."""
    root = etree.Element(_tag("ssv:ParameterSet"), nsmap={prefix: _NAMESPACES[prefix] for prefix in ("ssc", "ssv")})
    _parameter_set(root, values, tool)
    return _bytes(root)


def _system(node: Any, system: Subsystem) -> None:
    """The content of a system and of those within it."""
    _connectors(node, system.connectors)
    _bindings(node, system.bindings)
    # components and subsystems, then their connections
    elements = _add(node, "ssd:Elements") if system.components or system.systems else None
    for component in system.components:
        _component(elements, component)
    for inner in system.systems:
        _system(_add(elements, "ssd:System", name=inner.name), inner)
    if system.connections:
        connections = _add(node, "ssd:Connections")
        for connection in system.connections:
            _connection(connections, connection)


def _component(elements: Any, component: Component) -> None:
    """A component; connectors and bindings follow."""
    node = _add(elements, "ssd:Component", name=component.name, description=component.description)
    _set(node, type=FMU, source=component.source, implementation=component.implementation)
    _connectors(node, component.connectors)
    _bindings(node, component.bindings)
    if component.sampling is not None:
        annotation = _add(_add(node, "ssd:Annotations"), "ssc:Annotation", type=ANNOTATION)
        sample_time, offset = map(repr, component.sampling)
        _add(annotation, "flexfmu:Sampling", sampleTime=sample_time, offset=offset)


def _connectors(element: Any, connectors: Iterable[Connector]) -> None:
    """The connectors of an element, where it has any."""
    holder = None
    for each in connectors:
        holder = _add(element, "ssd:Connectors") if holder is None else holder
        node = _add(holder, "ssd:Connector", name=each.name, kind=each.kind)
        if each.type is not None:
            _add(node, f"ssc:{each.type}", unit=each.unit)


def _connection(connections: Any, connection: SspConnection) -> None:
    """A connection from start to end."""
    (start, output), (end, receiver) = connection.start, connection.end
    node = _add(connections, "ssd:Connection", startElement=start, startConnector=output)
    _set(node, endElement=end, endConnector=receiver)
    _set(node, suppressUnitConversion=None if connection.converts_units else "true")
    _transformation(node, connection.transformation)


def _transformation(node: Any, transformation: SspTransformation) -> None:
    """A linear map, unless it is the identity, or a table."""
    if isinstance(transformation, LinearMap):
        if transformation != IDENTITY:
            factor, offset = repr(transformation.factor), repr(transformation.offset)
            _add(node, "ssc:LinearTransformation", factor=factor, offset=offset)
        return
    # a table of the type of its values
    values = [each for pair in transformation.pairs for each in pair]
    kind = {bool: "Boolean", int: "Integer"}.get(type(values[0]) if values else str, "Enumeration")
    table = _add(node, f"ssc:{kind}MappingTransformation")
    for source, target in transformation.pairs:
        _add(table, "ssc:MapEntry", source=_text(source), target=_text(target))


def _bindings(element: Any, bindings: Iterable[Binding]) -> None:
    """Parameter sets of an element, where it has any."""
    holder = None
    for each in bindings:
        holder = _add(element, "ssd:ParameterBindings") if holder is None else holder
        node = _add(holder, "ssd:ParameterBinding", source=each.source, prefix=each.prefix)
        if each.source is None:
            _parameter_set(_add(_add(node, "ssd:ParameterValues"), "ssv:ParameterSet"), each.values)
        if each.mapping is not None:
            mapping = _add(_add(node, "ssd:ParameterMapping"), "ssm:ParameterMapping", version=VERSION)
            for entry in each.mapping:
                inner = _add(mapping, "ssm:MappingEntry", source=entry.source, target=entry.target)
                _set(inner, suppressUnitConversion=None if entry.converts_units else "true")
                _transformation(inner, entry.transformation)


def _parameter_set(node: Any, values: ParameterSet, tool: str | None = None) -> None:
    """Fill in a parameter set."""
    _set(node, version=VERSION, name=values.name, generationTool=tool)
    parameters = _add(node, "ssv:Parameters")
    for each in values.parameters:
        inner = _add(parameters, "ssv:Parameter", name=each.name)
        typed = _add(inner, f"ssv:{each.type}", unit=each.unit)
        typed.set("value", _text(each.value))
    _units(node, "ssv:Units", values.units)


def _units(root: Any, tag: str, units: Iterable[SspUnit]) -> None:
    """Definitions of units, where there are any."""
    holder = None
    for each in units:
        holder = _add(root, tag) if holder is None else holder
        exponents = {name: str(each.exponents[name]) for name in BASE_UNITS if name in each.exponents}
        base = _add(_add(holder, "ssc:Unit", name=each.name), "ssc:BaseUnit", **exponents)
        _set(base, factor=_unless(each.factor, 1.0), offset=_unless(each.offset, 0.0))


def _master(system: Any, structure: Structure) -> None:
    """OMSimulator's fixed-step master: version 3 looks for the attributes, version 2 for the element within."""
    step, tolerance = (None if v is None else repr(v) for v in (structure.step, structure.tolerance))
    if step is None and tolerance is None:
        return
    # both versions look for their own element and attribute
    (old, old_step), (new, new_step) = OMS_STEPS
    annotation = _add(_add(system, "ssd:Annotations"), "ssc:Annotation", type=OMS_ANNOTATION)
    node = _add(_add(annotation, "oms:Annotations"), f"oms:{new}", name="oms_ma_default", method="oms_ma")
    _set(node, **{new_step: step, "relativeTolerance": tolerance})
    if step is not None:
        _add(node, f"oms:{old}", description="oms-ma", **{old_step: step, "relativeTolerance": tolerance})


def _experiment(root: Any, structure: Structure) -> None:
    """Start, stop, and the step in an annotation, for which SSP 1.0 has no attribute."""
    times: Mapping[str, float | None] = {"startTime": structure.start, "stopTime": structure.stop}
    node = _add(root, "ssd:DefaultExperiment", **{k: None if v is None else repr(v) for k, v in times.items()})
    if structure.step is not None:
        annotation = _add(_add(node, "ssd:Annotations"), "ssc:Annotation", type=OSP_ANNOTATION)
        element, attribute = OSP_STEP
        _add(_add(annotation, "osp:Algorithm"), f"osp:{element}", **{attribute: repr(structure.step)})


def _add(parent: Any, tag: str, **attributes: str | None) -> Any:
    """A further child with those attributes that have a value."""
    child = etree.SubElement(parent, _tag(tag))
    _set(child, **attributes)
    return child


def _set(node: Any, **attributes: str | None) -> None:
    """Set those attributes that have a value."""
    for name, value in attributes.items():
        if value:
            node.set(name, value)


def _tag(name: str) -> str:
    """A name with prefix, ``ssd:System``, in lxml's form."""
    prefix, _, local = name.partition(":")
    return f"{{{_NAMESPACES[prefix]}}}{local}"


def _text(value: Value) -> str:
    """A value as XML Schema writes it; numbers read back exactly."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def _unless(value: float, default: float) -> str | None:
    """A number, None for the default."""
    return None if value == default else repr(value)


def _bytes(root: Any) -> bytes:
    """The document."""
    content: bytes = etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True)
    return content
