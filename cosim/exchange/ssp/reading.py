"""The structure of an SSP file with its parameter sets (SSV), mappings (SSM) and the bindings that apply them, read from XML (SSP 1.0,
and what SSP 2.0 has in common with it)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast, get_args

from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.master.linear_map import IDENTITY, LinearMap
from flexfmu.cosim.engine.slave import Type
from flexfmu.cosim.exchange.ssp.archive import SspArchive
from flexfmu.cosim.exchange.ssp.structure import (
    Binding,
    Component,
    Connector,
    ConnectorKind,
    MappingEntry,
    ParameterSet,
    SspConnection,
    SspParameter,
    SspTransformation,
    SspUnit,
    Structure,
    Subsystem,
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


FMU = "application/x-fmu-sharedlibrary"

ANNOTATION = "flexfmu"
"""Type of the annotation with the sample time of a component whose FMU doesn't state it."""

OSP_STEP = ("FixedStepAlgorithm", "baseStepSize")
"""Element and attribute of the Open Simulation Platform's annotation with the communication step."""

OMS_STEPS = (("FixedStepMaster", "stepSize"), ("SimulationInformation", "fixedStepSize"))
"""Elements and attributes with the communication step in annotations of OMSimulator 2 and 3."""


def read_structure(archive: SspArchive) -> Structure:
    """Read the description of an SSP's system.

    Raises:
        SspError: it isn't SSP 1 or 2, contradicts the standard, or has signal dictionaries or elements that are no FMUs.
    """
    name = archive.description
    root = parse(archive.read(name), archive.label(name), "SystemStructureDescription")
    # only versions that this program knows
    version = root.required("version")
    if not version.startswith(("1.", "2.")):
        raise root.error(f"is of SSP {version}; this program reads SSP 1.0, and what it has in SSP 2.0")
    system = root.child("System")
    if system is None:
        raise root.error("has no System; export it again")
    experiment = root.child("DefaultExperiment")
    # SSP 1.0 has no attribute for the step: known annotations do
    steps = [] if experiment is None else [(experiment, *OSP_STEP)]
    steps += [(system, *each) for each in OMS_STEPS]
    # the outermost system has the same elements as those within it
    outer = _system(system, archive)
    return Structure(
        **{**vars(outer), "name": root.required("name")},
        units=read_units(root),
        start=None if experiment is None else experiment.number("startTime"),
        stop=None if experiment is None else experiment.number("stopTime"),
        step=_positive(steps, " [s]"),
        tolerance=_positive([(system, element, "relativeTolerance") for element, _ in OMS_STEPS], ""),
        description=root.text("description") or "",
    )


def _system(node: XmlElement, archive: SspArchive) -> Subsystem:
    """Return a system with its elements and subsystems."""
    elements = [*node.children("Elements", "*")]
    systems = tuple(_system(each, archive) for each in elements if each.tag == "System")
    return Subsystem(
        name=node.text("name") or "",
        components=tuple(_component(each, archive) for each in elements if each.tag != "System"),
        connections=tuple(_connection(each) for each in node.children("Connections", "Connection")),
        connectors=_connectors(node),
        bindings=read_bindings(node, archive),
        systems=systems,
        where=node.where,
    )


def _positive(places: Sequence[tuple[XmlElement, str, str]], unit: str) -> float | None:
    """The first number that is stated at one of the places, None where there is none.

    Args:
        places: (element around, name of the element, attribute).
        unit: of the number, for errors.

    Raises:
        SspError: it isn't positive.
    """
    for around, element, attribute in places:
        for node in around.descendants(element):
            value = node.number(attribute)
            if value is not None and value <= 0.0:
                raise node.error(f"has {attribute}='{value:g}', which must be positive{unit}")
            if value is not None:
                return value
    return None


def _component(node: XmlElement, archive: SspArchive) -> Component:
    """A component that is an FMU for co-simulation.

    Raises:
        SspError: it is anything else.
    """
    # path within the archive
    _check_kind(node)
    source = archive.resolve(node.required("source"), node.where)
    name = node.required("name")
    return Component(
        name,
        source,
        _connectors(node),
        read_bindings(node, archive),
        node.text("description") or "",
        node.where,
        _sampling(node),
        node.text("implementation") or "CoSimulation",
    )


def _sampling(node: XmlElement) -> tuple[float, float] | None:
    """Sample time and offset [s] in a component's annotation; None where there is none.

    Raises:
        SspError: the sample time isn't positive, or the offset is negative.
    """
    for each in node.children("Annotations", "Annotation"):
        if each.text("type") != ANNOTATION:
            continue
        for found in each.descendants("Sampling"):
            sample_time, offset = found.number("sampleTime"), found.number("offset") or 0.0
            if sample_time is None or sample_time <= 0.0 or offset < 0.0:
                raise found.error(
                    f"has sampleTime={found.text('sampleTime')!r}, which must be positive [s], and offset="
                    f"{found.text('offset')!r}, which must be zero or positive [s]"
                )
            return sample_time, offset
    return None


def _check_kind(node: XmlElement) -> None:
    """Check that the element is an FMU.

    Raises:
        SspError: it is something else.
    """
    if node.tag == "SignalDictionaryReference":
        raise node.error("is a signal dictionary, which this program doesn't read; connect its signals directly")
    if node.tag != "Component":
        raise node.error("is not supported; only components that are FMUs are, connect them directly")
    if (kind := node.text("type") or FMU) != FMU:
        raise node.error(f"has the type {kind!r}; only FMUs ({FMU}) can be run, put the package's FMUs in directly")


def _connectors(node: XmlElement) -> tuple[Connector, ...]:
    """Connectors of an element.

    Raises:
        SspError: two share a name, or one is of an unknown kind.
    """
    found = tuple(_connector(each) for each in node.children("Connectors", "Connector"))
    names = [each.name for each in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise node.error(f"has two connectors named {twice!r}; keep one")
    return found


def _connector(node: XmlElement) -> Connector:
    """One connector."""
    name, kind = node.required("name"), node.required("kind")
    if kind not in get_args(ConnectorKind):
        raise node.error(f"has the kind {kind!r}, which must be one of {', '.join(get_args(ConnectorKind))}")
    if node.child("Dimension") is not None:
        raise node.error("is an array of SSP 2.0, which this program doesn't read; connect its elements one by one")
    # types of SSP 1.0 and numbers of 2.0; a connector may have none
    kinds = (*get_args(Type), *NUMBERS, "Binary")
    typed = next((each for each in node.children("*") if each.tag in kinds), None)
    connector_type = None if typed is None else NUMBERS.get(typed.tag, cast(Type, typed.tag))
    return Connector(
        name, cast(ConnectorKind, kind), connector_type, None if typed is None else typed.text("unit"), node.where
    )


def _connection(node: XmlElement) -> SspConnection:
    """One connection."""
    return SspConnection(
        (node.text("startElement") or None, node.required("startConnector")),
        (node.text("endElement") or None, node.required("endConnector")),
        read_transformation(node),
        not node.boolean("suppressUnitConversion"),
        node.where,
    )
