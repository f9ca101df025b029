"""Whatever an exported scene may say is written as valid SSP 1.0 and reads back as it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fmpy.ssp.ssd import read_ssd, read_ssv
from hypothesis import given, settings
from hypothesis import strategies as st
from ssp_support.packages import package

from flexfmu.cosim.exchange.ssp.archive import SspArchive
from flexfmu.cosim.exchange.ssp.structure import (
    BASE_UNITS,
    Binding,
    Component,
    Connector,
    ParameterSet,
    SspConnection,
    SspParameter,
    SspUnit,
    Structure,
    read_structure,
    ssd_xml,
    ssv_xml,
)

NAMES = st.text("abcXYZ019._-[]<>&\"'äé ,;()", min_size=1, max_size=12)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(1e-12, 1e3)
EXPONENTS = st.dictionaries(st.sampled_from(BASE_UNITS), st.integers(-4, 4).filter(bool))
UNITS = st.builds(SspUnit, NAMES, EXPONENTS, NUMBERS.filter(bool), NUMBERS.map(abs))
PARAMETERS = (
    st.builds(SspParameter, NAMES, st.just("Real"), NUMBERS, st.none() | NAMES)
    | st.builds(SspParameter, NAMES, st.just("Integer"), st.integers(-(2**31), 2**31 - 1))
    | st.builds(SspParameter, NAMES, st.just("Boolean"), st.booleans())
    | st.builds(SspParameter, NAMES, st.sampled_from(["String", "Enumeration"]), NAMES)
)


def few(strategy: Any, by: str | None = None) -> Any:
    """A short tuple, names unique."""
    return st.lists(strategy, max_size=3, unique_by=None if by is None else lambda each: getattr(each, by)).map(tuple)


SETS = st.builds(ParameterSet, NAMES, few(PARAMETERS, "name"), few(UNITS, "name"))
KINDS = st.sampled_from(["input", "output", "parameter", "calculatedParameter", "inout"])
CONNECTORS = st.builds(Connector, NAMES, KINDS, st.just("Real"), st.none() | NAMES) | st.builds(
    Connector, NAMES, KINDS, st.sampled_from([None, "Integer", "Boolean", "String"])
)
COMPONENTS = st.builds(
    Component,
    NAMES,
    st.just("resources/a_b.fmu"),
    few(CONNECTORS, "name"),
    description=st.just("") | NAMES,
    sampling=st.none() | st.tuples(POSITIVE, st.just(0.0) | POSITIVE),
)
ENDS = st.tuples(st.none() | NAMES, NAMES)
STRUCTURES = st.builds(
    Structure,
    NAMES,
    few(COMPONENTS, "name").filter(bool),
    few(st.builds(SspConnection, ENDS, ENDS)),
    bindings=st.tuples(st.builds(Binding, SETS, st.just("") | NAMES, source=st.just("resources/values.ssv"))),
    units=few(UNITS, "name"),
    start=st.none() | NUMBERS,
    stop=st.none() | NUMBERS,
    step=st.none() | POSITIVE,
    tolerance=st.none() | POSITIVE,
    description=st.just("") | NAMES,
)


def bare(value: Any) -> Any:
    """The value without the places in the file, which only errors need."""
    if isinstance(value, tuple):
        return tuple(map(bare, value))
    if not hasattr(value, "__dataclass_fields__"):
        return value
    return type(value), {name: bare(each) for name, each in vars(value).items() if name != "where"}


@settings(max_examples=30)
@given(structure=STRUCTURES)
def test_round_trip(structure: Structure, tmp_path: Path) -> None:
    """Names with markup, numbers to the last bit, all types of values; fmpy holds both files to the standard's schema."""
    values = structure.bindings[0].values
    files = {"SystemStructure.ssd": ssd_xml(structure, "test"), "resources/values.ssv": ssv_xml(values, "test")}
    path = package(tmp_path / "any.ssp", files)
    assert bare(read_structure(SspArchive(path))) == bare(structure)
    assert read_ssd(path, validate=True).name == structure.name
    assert len(read_ssv(path, resource="resources/values.ssv", validate=True).parameters) == len(values.parameters)
