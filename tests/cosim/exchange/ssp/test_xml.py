"""Whatever can be said of a system is written as valid SSP 1.0 and reads back as it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fmpy.ssp.ssd import read_ssd, read_ssv
from hypothesis import given, settings
from hypothesis import strategies as st
from ssp_support.packages import package

from flexfmu.cosim.engine.master.linear_map import LinearMap
from flexfmu.cosim.exchange.ssp.archive import SspArchive
from flexfmu.cosim.exchange.ssp.structure import (
    Binding,
    Component,
    Connector,
    MappingEntry,
    ParameterSet,
    SspConnection,
    SspParameter,
    SspUnit,
    Structure,
    Subsystem,
    ValueMap,
)
from flexfmu.cosim.exchange.ssp.xml import BASE_UNITS, read_structure, ssd_xml, ssv_xml

NAMES = st.text("abcXYZ019._-[]<>&\"'äé ,;()", min_size=1, max_size=12)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
FACTORS = NUMBERS.filter(bool)
LINEAR = st.builds(LinearMap, NUMBERS, NUMBERS)
UNITS = st.builds(
    SspUnit,
    NAMES,
    st.dictionaries(st.sampled_from(BASE_UNITS), st.integers(-4, 4).filter(bool)),
    FACTORS,
    NUMBERS.map(abs),
)
VALUES: dict[str, Any] = {
    "Real": NUMBERS,
    "Integer": st.integers(-(2**31), 2**31 - 1),
    "Boolean": st.booleans(),
    "String": NAMES,
    "Enumeration": NAMES,
}


@st.composite
def parameters(draw: st.DrawFn) -> SspParameter:
    """A parameter of any type."""
    kind: Any = draw(st.sampled_from(sorted(VALUES)))
    return SspParameter(draw(NAMES), kind, draw(VALUES[kind]), draw(st.none() | NAMES) if kind == "Real" else None)


def few(strategy: Any, by: str | None = None) -> Any:
    """A short tuple, names unique."""
    return st.lists(strategy, max_size=3, unique_by=None if by is None else lambda each: getattr(each, by)).map(tuple)


SETS = st.builds(ParameterSet, NAMES, few(parameters(), "name"), few(UNITS, "name"))
TABLES = st.sampled_from([st.booleans(), st.integers(-9, 9), NAMES]).flatmap(
    lambda kind: st.lists(st.tuples(kind, kind), min_size=1, max_size=3).map(lambda pairs: ValueMap(tuple(pairs)))
)
TRANSFORMATIONS = LINEAR | TABLES
ENTRIES = st.builds(MappingEntry, NAMES, NAMES, TRANSFORMATIONS, st.booleans())
BINDINGS = st.builds(Binding, SETS, st.just("") | NAMES, st.none() | few(ENTRIES))


@st.composite
def connectors(draw: st.DrawFn) -> Connector:
    """A connector with or without type and unit."""
    kind: Any = draw(st.sampled_from(["input", "output", "parameter", "calculatedParameter", "inout"]))
    typed: Any = draw(st.sampled_from([None, "Real", "Integer", "Boolean", "String"]))
    return Connector(draw(NAMES), kind, typed, draw(st.none() | NAMES) if typed == "Real" else None)


COMPONENTS = st.builds(
    Component,
    NAMES,
    st.just("resources/a b.fmu".replace(" ", "_")),
    few(connectors(), "name"),
    few(BINDINGS),
    st.just("") | NAMES,
    implementation=st.sampled_from(["any", "CoSimulation", "ModelExchange"]),
)
ENDS = st.tuples(st.none() | NAMES, NAMES)
CONNECTIONS = few(st.builds(SspConnection, ENDS, ENDS, TRANSFORMATIONS, st.booleans()))
SYSTEM = (NAMES, few(COMPONENTS, "name"), CONNECTIONS, few(connectors(), "name"), few(BINDINGS))
SYSTEMS = st.builds(Subsystem, *SYSTEM) | st.builds(Subsystem, *SYSTEM, few(st.builds(Subsystem, *SYSTEM), "name"))
STRUCTURES = st.builds(
    Structure,
    NAMES,
    few(COMPONENTS, "name").filter(bool),
    CONNECTIONS,
    few(connectors(), "name"),
    few(BINDINGS),
    few(SYSTEMS, "name"),
    st.just(""),
    few(UNITS, "name"),
    st.none() | NUMBERS,
    st.none() | NUMBERS,
    st.none() | st.floats(1e-9, 1e3),
    st.none() | st.floats(1e-12, 1.0),
    st.just("") | NAMES,
)


def bare(value: Any) -> Any:
    """The value without the places in the file, which only errors need."""
    if isinstance(value, tuple):
        return tuple(map(bare, value))
    if not hasattr(value, "__dataclass_fields__"):
        return value
    return type(value), {name: bare(getattr(value, name)) for name in value.__dataclass_fields__ if name != "where"}


@settings(max_examples=25)
@given(structure=STRUCTURES)
def test_round_trip(structure: Structure, tmp_path: Path) -> None:
    """Names with markup, numbers to the last bit, all kinds of bindings; fmpy holds the file to the standard's schema."""
    path = package(tmp_path / "any.ssp", {"SystemStructure.ssd": ssd_xml(structure, "test")})
    assert bare(read_structure(SspArchive(path))) == bare(structure)
    assert read_ssd(path, validate=True).name == structure.name


@settings(max_examples=30)
@given(values=SETS)
def test_external_sets(values: ParameterSet, tmp_path: Path) -> None:
    """A parameter set in a file of its own is valid too, and reads back."""
    structure = Structure("s", (), (), bindings=(Binding(values, source="resources/values.ssv"),))
    files = {"SystemStructure.ssd": ssd_xml(structure, "test"), "resources/values.ssv": ssv_xml(values, "test")}
    path = package(tmp_path / "any.ssp", files)
    assert bare(read_structure(SspArchive(path)).bindings) == bare(structure.bindings)
    assert len(read_ssv(path, resource="resources/values.ssv", validate=True).parameters) == len(values.parameters)
