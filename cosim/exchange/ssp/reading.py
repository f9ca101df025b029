"""The structure of an SSP file, read from its XML (SSP 1.0, and what SSP 2.0 has in common with it)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast, get_args

from flexfmu.cosim.engine.slave import Type
from flexfmu.cosim.exchange.ssp.archive import SspArchive
from flexfmu.cosim.exchange.ssp.parameter_reading import NUMBERS, read_bindings, read_transformation, read_units
from flexfmu.cosim.exchange.ssp.structure import (
    Component,
    Connector,
    ConnectorKind,
    SspConnection,
    Structure,
    Subsystem,
)
from flexfmu.cosim.exchange.ssp.xml_tree import XmlElement, parse

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
