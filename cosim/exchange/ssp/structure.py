"""A system structure description (SSD) as data, with its parameter sets (SSV) and mappings (SSM), and its XML.

Names follow SSP 1.0 (Modelica Association, 2019). Read are SSP 1.0 and what SSP 2.0 has in common with it. Written is what an exported
scene has, in SSP 1.0; the same structure gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isclose
from typing import Any, Literal, cast, get_args

from lxml import etree

from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.master.system import IDENTITY, LinearMap
from flexfmu.cosim.engine.slave import Type
from flexfmu.cosim.exchange.ssp.archive import NAMESPACES, SspArchive, XmlElement

ConnectorKind = Literal["input", "output", "parameter", "calculatedParameter", "inout"]


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


VERSION, FMU = "1.0", "application/x-fmu-sharedlibrary"

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

NUMBERS: dict[str, Type] = {
    **dict.fromkeys(("Float32", "Float64"), "Real"),
    **dict.fromkeys(("Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"), "Integer"),
}
"""Types of numbers in SSP 2.0 and FMI 3.0 → those of SSP 1.0 and FMI 2.0."""

ANNOTATION, OSP_ANNOTATION, OMS_ANNOTATION = "flexfmu", "com.opensimulationplatform", "org.openmodelica"
"""Types of annotations: with the sample time of a component whose FMU doesn't state it; with the communication step, as libcosim reads
it; and with communication step and tolerance, as OMSimulator reads them."""

OSP_STEP = ("FixedStepAlgorithm", "baseStepSize")
"""Element and attribute of the Open Simulation Platform's annotation with the communication step."""

OMS_STEPS = (("FixedStepMaster", "stepSize"), ("SimulationInformation", "fixedStepSize"))
"""Elements and attributes with the communication step in annotations of OMSimulator 2 and 3."""

_NAMESPACES = {
    **NAMESPACES,
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
    "flexfmu": "urn:flexfmu:ssp",
}
"""Prefixes; some importers look for them literally, and libcosim takes declarations below the root for elements."""


def read_structure(archive: SspArchive) -> Structure:
    """Read the description of an SSP's system.

    Raises:
        SspError: it isn't SSP 1 or 2, contradicts the standard, or has signal dictionaries or elements that are no FMUs.
    """
    root = archive.parse(archive.description, "SystemStructureDescription")
    # only versions that this program knows
    version = root.required("version")
    if not version.startswith(("1.", "2.")):
        raise root.error(f"is of SSP {version}; this program reads SSP 1.0, and what it has in SSP 2.0")
    system, experiment = root.child("System"), root.child("DefaultExperiment")
    if system is None:
        raise root.error("has no System; export it again")
    # SSP 1.0 has no attribute for the step: known annotations do
    steps = [] if experiment is None else [(experiment, *OSP_STEP)]
    steps += [(system, *each) for each in OMS_STEPS]
    # the outermost system has the same elements as those within it
    return Structure(
        **{**vars(_read_system(system, archive)), "name": root.required("name")},
        units=_read_units(root),
        start=None if experiment is None else experiment.number("startTime"),
        stop=None if experiment is None else experiment.number("stopTime"),
        step=_positive(steps, " [s]"),
        tolerance=_positive([(system, element, "relativeTolerance") for element, _ in OMS_STEPS], ""),
        description=root.text("description") or "",
    )


def _positive(places: Sequence[tuple[XmlElement, str, str]], unit: str) -> float | None:
    """The first number that is stated at one of the places (element around, name of the element, attribute), None where there is none.

    Raises:
        SspError: it isn't positive; the message has the unit.
    """
    for around, element, attribute in places:
        for node in around.descendants(element):
            value = node.number(attribute)
            if value is not None and value <= 0.0:
                raise node.error(f"has {attribute}='{value:g}', which must be positive{unit}")
            if value is not None:
                return value
    return None


def _read_system(node: XmlElement, archive: SspArchive) -> Subsystem:
    """A system with its elements and subsystems."""
    elements = [*node.children("Elements", "*")]
    return Subsystem(
        name=node.text("name") or "",
        components=tuple(_read_component(each, archive) for each in elements if each.tag != "System"),
        connections=tuple(
            SspConnection(
                (each.text("startElement") or None, each.required("startConnector")),
                (each.text("endElement") or None, each.required("endConnector")),
                _read_transformation(each),
                not each.value("Boolean", "suppressUnitConversion"),
                each.where,
            )
            for each in node.children("Connections", "Connection")
        ),
        connectors=_read_connectors(node),
        bindings=_read_bindings(node, archive),
        systems=tuple(_read_system(each, archive) for each in elements if each.tag == "System"),
        where=node.where,
    )


def _read_component(node: XmlElement, archive: SspArchive) -> Component:
    """A component that is an FMU for co-simulation.

    Raises:
        SspError: it is anything else.
    """
    if node.tag == "SignalDictionaryReference":
        raise node.error("is a signal dictionary, which this program doesn't read; connect its signals directly")
    if node.tag != "Component":
        raise node.error("is not supported; only components that are FMUs are, connect them directly")
    if (kind := node.text("type") or FMU) != FMU:
        raise node.error(f"has the type {kind!r}; only FMUs ({FMU}) can be run, put the package's FMUs in directly")
    # path within the archive
    source = archive.resolve(node.required("source"), node.where)
    # sample time and offset [s] in our annotation
    sampling = None
    own = (each for each in node.children("Annotations", "Annotation") if each.text("type") == ANNOTATION)
    for found in (inner for each in own for inner in each.descendants("Sampling")):
        sample_time, offset = found.number("sampleTime"), found.number("offset") or 0.0
        if sample_time is None or sample_time <= 0.0 or offset < 0.0:
            raise found.error(
                f"has sampleTime={found.text('sampleTime')!r}, which must be positive [s], and offset="
                f"{found.text('offset')!r}, which must be zero or positive [s]"
            )
        sampling = sampling or (sample_time, offset)
    return Component(
        node.required("name"),
        source,
        _read_connectors(node),
        _read_bindings(node, archive),
        node.text("description") or "",
        node.where,
        sampling,
        node.text("implementation") or "CoSimulation",
    )


def _read_connectors(node: XmlElement) -> tuple[Connector, ...]:
    """Connectors of an element.

    Raises:
        SspError: two share a name, or one is of an unknown kind.
    """
    found: dict[str, Connector] = {}
    for each in node.children("Connectors", "Connector"):
        name, kind = each.required("name"), each.required("kind")
        if kind not in get_args(ConnectorKind):
            raise each.error(f"has the kind {kind!r}, which must be one of {', '.join(get_args(ConnectorKind))}")
        if each.child("Dimension") is not None:
            raise each.error("is an array of SSP 2.0, which this program doesn't read; connect its elements one by one")
        if name in found:
            raise node.error(f"has two connectors named {name!r}; keep one")
        # a connector may have no type
        value, type_ = _typed(each)
        unit = None if value is None else value.text("unit")
        found[name] = Connector(name, cast(ConnectorKind, kind), type_, unit, each.where)
    return tuple(found.values())


def _typed(node: XmlElement) -> tuple[XmlElement | None, Any]:
    """The element with the type or value of a connector or parameter, and its type in SSP 1.0; None for both where there is none."""
    kinds = (*get_args(Type), *NUMBERS, "Binary")
    found = next((each for each in node.children("*") if each.tag in kinds), None)
    return found, None if found is None else NUMBERS.get(found.tag, found.tag)


def _read_transformation(node: XmlElement) -> SspTransformation:
    """The transformation of a connection or mapping entry.

    Raises:
        SspError: an attribute is missing or invalid.
    """
    for kind in ("Boolean", "Integer", "Enumeration"):
        if (table := node.child(f"{kind}MappingTransformation")) is not None:
            pairs = []
            for each in table.children("MapEntry"):
                source, target = (each.value(kind, end) for end in ("source", "target"))
                if source is None or target is None:
                    raise each.error("needs the attributes 'source' and 'target'; add them")
                pairs.append((source, target))
            return ValueMap(tuple(pairs))
    linear = node.child("LinearTransformation")
    if linear is None:
        return IDENTITY
    factor, offset = linear.number("factor"), linear.number("offset")
    return LinearMap(1.0 if factor is None else factor, 0.0 if offset is None else offset)


def _read_bindings(element: XmlElement, archive: SspArchive) -> tuple[Binding, ...]:
    """The parameter bindings of a component or system.

    Raises:
        SspError: a set is missing, broken, or of another kind.
    """
    found = []
    for each in element.children("ParameterBindings", "ParameterBinding"):
        root, source = _content(each, archive, "ParameterSet", "parameter-set", "ParameterValues")
        mapping, entries = each.child("ParameterMapping"), None
        if mapping is not None:
            entries = tuple(
                MappingEntry(
                    entry.required("source"),
                    entry.required("target"),
                    _read_transformation(entry),
                    not entry.value("Boolean", "suppressUnitConversion"),
                )
                for entry in _content(mapping, archive, "ParameterMapping", "parameter-mapping")[0].children(
                    "MappingEntry"
                )
                if entry.text("source") != ""  # an empty entry of a template
            )
        found.append(Binding(_read_parameter_set(root), each.text("prefix") or "", entries, source, each.where))
    return tuple(found)


def _content(
    node: XmlElement, archive: SspArchive, root: str, kind: str, *around: str
) -> tuple[XmlElement, str | None]:
    """The root element of a parameter set or mapping, and the file of an external one.

    Args:
        node: the element that refers to it, or has it within.
        archive: where external ones are.
        root: name of the root element.
        kind: end of its media type.
        around: names of elements around one within.

    Raises:
        SspError: there is none, or it is of another kind.
    """
    if node.text("type") not in (None, "", expected := f"application/x-ssp-{kind}"):
        raise node.error(f"has the type {node.text('type')!r}; only {expected} can be read")
    source = node.text("source")
    if not source:
        if (inner := node.child(*around, root)) is None:
            raise node.error(f"has neither a source nor a {root} within; add one of them")
        return inner, None
    base = node.text("sourceBase") or "SSD"
    if base == "component":
        raise node.error("takes its source from within an FMU (sourceBase='component'); put the file beside the FMU")
    if base != "SSD":
        raise node.error(f"has sourceBase={base!r}, which must be SSD or component")
    file = archive.resolve(source, node.where)
    return archive.parse(file, root, node.where), file


def _read_parameter_set(root: XmlElement) -> ParameterSet:
    """A parameter set; for a repeated name the last value counts.

    Raises:
        SspError: a parameter has no value, or one that FMI 2.0 doesn't have.
    """
    found: dict[str, SspParameter] = {}
    repeated: list[str] = []
    for node in root.children("Parameters", "Parameter"):
        value, kind = _typed(node)
        if value is None:
            raise node.error(f"has no value; give it one of {', '.join(get_args(Type))}")
        if kind == "Binary":
            raise node.error("is Binary, which FMI 2.0 doesn't have; leave it out")
        if len((value.text("value") or "").split()) > 1 and value.tag != kind:
            raise value.error(
                "is an array of SSP 2.0, which this program doesn't read; give each element its own value"
            )
        content = value.value(kind, "value")
        if content is None:
            raise value.error("lacks the attribute 'value'; add it")
        each = SspParameter(node.required("name"), kind, content, value.text("unit"))
        if found.get(each.name, each) != each:
            repeated.append(f"{root.where} has the parameter {each.name!r} twice, {each.value!r} counts")
        found[each.name] = each
    return ParameterSet(root.required("name"), tuple(found.values()), _read_units(root), tuple(repeated))


def _read_units(root: XmlElement) -> tuple[SspUnit, ...]:
    """The units that a file defines.

    Raises:
        SspError: one isn't defined, or its factor is zero.
    """
    found = []
    for node in root.children("Units", "Unit"):
        if (base := node.child("BaseUnit")) is None:
            raise node.error("has no BaseUnit; add it")
        exponents = {name: int(power) for name in BASE_UNITS if (power := base.value("Integer", name))}
        factor, offset = base.number("factor"), base.number("offset")
        if factor == 0.0:
            raise base.error("has factor='0', which no value can be converted with")
        found.append(SspUnit(node.required("name"), exponents, 1.0 if factor is None else factor, offset or 0.0))
    return tuple(found)


def ssd_xml(structure: Structure, tool: str) -> bytes:
    """Content of ``SystemStructure.ssd``.

    Args:
        structure: a system of components and connections without transformations, whose parameter sets are files.
        tool: name of the program that wrote it.
    """
    name, description, step = structure.name, structure.description, structure.step
    # OMSimulator's fixed-step master: version 3 looks for the attributes, version 2 for the element within
    annotations = []
    if step is not None or structure.tolerance is not None:
        (old, old_step), (new, new_step) = OMS_STEPS
        steps = {old_step: step, "relativeTolerance": structure.tolerance}
        master = _element(f"oms:{old}", description="oms-ma", **steps) if step is not None else None
        steps = {new_step: step, "relativeTolerance": structure.tolerance}
        newer = _element(f"oms:{new}", master, name="oms_ma_default", method="oms_ma", **steps)
        annotations.append(_annotation(OMS_ANNOTATION, _element("oms:Annotations", newer)))
    bindings = (_element("ssd:ParameterBinding", source=each.source, prefix=each.prefix) for each in structure.bindings)
    connections = (
        _element("ssd:Connection", startElement=a, startConnector=output, endElement=b, endConnector=receiver)
        for (a, output), (b, receiver) in ((each.start, each.end) for each in structure.connections)
    )
    content = (
        _list("ssd:ParameterBindings", bindings),
        _list("ssd:Elements", map(_component, structure.components)),
        _list("ssd:Connections", connections),
    )
    system = _element("ssd:System", *content, *annotations, name=name, description=description)
    # start, stop, and the step in an annotation, for which SSP 1.0 has no attribute
    annotations = []
    if step is not None:
        algorithm = _element("osp:Algorithm", _element(f"osp:{OSP_STEP[0]}", **{OSP_STEP[1]: step}))
        annotations.append(_annotation(OSP_ANNOTATION, algorithm))
    experiment = _element("ssd:DefaultExperiment", *annotations, startTime=structure.start, stopTime=structure.stop)
    said = {"version": VERSION, "name": name, "description": description, "generationTool": tool}
    units = _list("ssd:Units", map(_unit, structure.units))
    return _bytes(_element("ssd:SystemStructureDescription", system, units, experiment, **said), _NAMESPACES)


def ssv_xml(values: ParameterSet, tool: str) -> bytes:
    """Content of a parameter set in a file of its own, with its units."""
    parameters = []
    for each in values.parameters:
        typed = _element(f"ssv:{each.type}", unit=each.unit)
        typed.set("value", _text(each.value))  # an empty text, too
        parameters.append(_element("ssv:Parameter", typed, name=each.name))
    content = _element("ssv:Parameters", *parameters), _list("ssv:Units", map(_unit, values.units))
    found = _element("ssv:ParameterSet", *content, version=VERSION, name=values.name, generationTool=tool)
    return _bytes(found, ("ssc", "ssv"))


def _component(component: Component) -> Any:
    """A component with its connectors."""
    connectors = (
        _element(
            "ssd:Connector", each.type and _element(f"ssc:{each.type}", unit=each.unit), name=each.name, kind=each.kind
        )
        for each in component.connectors
    )
    content = [_list("ssd:Connectors", connectors)]
    if component.sampling is not None:
        sample_time, offset = component.sampling
        content.append(_annotation(ANNOTATION, _element("flexfmu:Sampling", sampleTime=sample_time, offset=offset)))
    said = {"name": component.name, "description": component.description, "type": FMU, "source": component.source}
    return _element("ssd:Component", *content, **said, implementation=component.implementation)


def _unit(unit: SspUnit) -> Any:
    """The definition of a unit."""
    exponents = {name: unit.exponents[name] for name in BASE_UNITS if name in unit.exponents}
    factor, offset = (
        None if value == default else value for value, default in ((unit.factor, 1.0), (unit.offset, 0.0))
    )
    return _element("ssc:Unit", _element("ssc:BaseUnit", **exponents, factor=factor, offset=offset), name=unit.name)


def _annotation(kind: str, content: Any) -> Any:
    """The annotations of an element: a single one."""
    return _element("ssd:Annotations", _element("ssc:Annotation", content, type=kind))


def _list(tag: str, children: Iterable[Any]) -> Any:
    """An element around these, None where there are none."""
    found = [*children]
    return _element(tag, *found) if found else None


def _element(tag: str, *children: Any, **attributes: Value | None) -> Any:
    """The element called ``ssd:System``, for example, with those children that there are, and those attributes that have a value."""
    prefix, _, local = tag.partition(":")
    found = {name: _text(value) for name, value in attributes.items() if value is not None and value != ""}
    node = etree.Element(f"{{{_NAMESPACES[prefix]}}}{local}", found, _NAMESPACES)
    node.extend(each for each in children if each is not None)
    return node


def _text(value: Value) -> str:
    """A value as XML Schema writes it; numbers read back exactly."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def _bytes(root: Any, namespaces: Iterable[str]) -> bytes:
    """The document, whose root declares namespaces with these prefixes."""
    etree.cleanup_namespaces(root, keep_ns_prefixes=[*namespaces])
    content: bytes = etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True)
    return content
