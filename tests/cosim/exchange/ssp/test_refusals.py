"""What can't be run is refused in one line that names file, element and remedy; nothing in a file is trusted."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from ssp_support import packages

from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.exchange.ssp.archive import DESCRIPTION, SspArchive, SspError
from flexfmu.cosim.exchange.ssp.loading import load_ssp

MakeSsp = Callable[..., Path]


def refusal(path: Path, **options: float) -> str:
    """The one line with which a file is refused."""
    with pytest.raises(InputError) as caught:
        load_ssp(path, **{"step": 0.125, **options})
    message = str(caught.value)
    assert "\n" not in message
    return message


def changed(old: str, new: str) -> str:
    """The description with a change."""
    assert old in packages.SSD
    return packages.SSD.replace(old, new)


MAPPED = f'<ssm:ParameterMapping {packages.NAMESPACES} version="1.0"><ssm:MappingEntry source="a" target="rate"><ssc:BooleanMappingTransformation/></ssm:MappingEntry></ssm:ParameterMapping>'

EMPTY = f'<ssd:SystemStructureDescription {packages.NAMESPACES} version="1.0" name="x">{{}}</ssd:SystemStructureDescription>'
INNER = '<ssd:System name="inner"><ssd:Elements>'
PASSING = (
    '<ssd:System name="inner"><ssd:Connectors><ssd:Connector name="a" kind="input"/><ssd:Connector name="b" kind="output"/>'
    '</ssd:Connectors><ssd:Connections><ssd:Connection startConnector="a" endConnector="b"/></ssd:Connections></ssd:System>'
)
RING = (
    '<ssd:Connection startElement="inner" startConnector="b" endElement="inner" endConnector="a"/>'
    '<ssd:Connection startElement="inner" startConnector="b" endElement="second" endConnector="u"/>'
)
TABLE = "<ssc:IntegerMappingTransformation>{}</ssc:IntegerMappingTransformation>".format(
    "".join(f'<ssc:MapEntry source="{i}" target="{i * i}"/>' for i in range(3))
)

WRONG: dict[str, tuple[str, str]] = {
    "no XML": ("<ssd:System", "is no XML"),
    "another root": ("<a/>", "must begin with <SystemStructureDescription>"),
    "version": (changed('version="1.0" name', 'version="3.0" name'), "is of SSP 3.0"),
    "no system": (EMPTY.format(""), "has no System"),
    "no components": (EMPTY.format('<ssd:System name="s"/>'), "has no components"),
    "nested system of the same name": (changed("<ssd:Elements>", '<ssd:Elements><ssd:System name="first"/>'), "<Component name='first'>: another element has the same name"),
    "ring of connectors": (
        changed("<ssd:Elements>", f"<ssd:Elements>{PASSING}").replace(packages.CONNECTION, RING),
        "connectors feed each other in a ring: second.u <- inner.b <- inner.a <- inner.b",
    ),
    "dictionary": (
        changed("<ssd:Elements>", '<ssd:Elements><ssd:SignalDictionaryReference name="d" dictionary="e"/>'),
        "<SignalDictionaryReference name='d'> is a signal dictionary, which",
    ),
    "package in package": (
        changed('name="first"', 'name="first" type="application/x-ssp-package"'),
        "has the type 'application/x-ssp-package'",
    ),
    "no name": (changed('name="first"', 'id="first"'), "lacks the attribute 'name'"),
    "same name": (changed('name="first"', 'name="second"'), "another element has the same name"),
    "missing file": (changed("resources/decay.fmu", "resources/decoy.fmu"), "isn't in decays.ssp; it holds"),
    "from the net": (changed("resources/decay.fmu", "http://localhost/decay.fmu"), "only files within the archive"),
    "absolute": (changed("resources/decay.fmu", "/etc/passwd"), "relative to SystemStructure.ssd"),
    "upwards": (changed("resources/decay.fmu", "../decay.fmu"), "leads out of the archive"),
    "upwards, hidden": (changed("resources/decay.fmu", "resources/%2e%2e/%2E%2E/decay.fmu"), "leads out of the archive"),
    "backslash": (changed("resources/decay.fmu", "resources\\decay.fmu"), "with slashes"),
    "unknown variable": (changed('name="u"', 'name="uu"').replace('endConnector="u"', 'endConnector="uu"'), "<Connector name='uu'> of 'second': resources/decay.fmu has no variable 'uu'; did you mean 'u'?"),
    "wrong direction": (changed('name="u" kind="input"', 'name="u" kind="output"'), "is of kind output; in resources/decay.fmu it is input"),
    "wrong type": (changed('<ssc:Real unit="m"/>', "<ssc:Integer/>"), "is Integer; in resources/decay.fmu it is Real"),
    "unknown kind": (changed('kind="input"', 'kind="inlet"'), "has the kind 'inlet'"),
    "two connectors": (changed('name="steps" kind="output"', 'name="x" kind="output"'), "two connectors named 'x'"),
    "wrong unit": (changed('<ssc:Real unit="m"/>', '<ssc:Real unit="mm"/>'), "is in mm; in resources/decay.fmu it is in m"),
    "binary": (changed('<ssc:Real unit="m"/>', "<ssc:Binary/>"), "is Binary"),
    "array": (changed("<ssc:Integer/>", '<ssc:Integer/><ssd:Dimension size="3"/>'), "is an array of SSP 2.0"),
    "unknown element": (packages.connected(startElement="furst"), "names the element 'furst', which doesn't exist; did you mean 'first'?"),
    "unknown connector": (packages.connected(startConnector="y"), "names the connector 'y', which 'first' doesn't have"),
    "unknown system connector": (packages.connected(startElement=""), "names the system's connector 'x', which doesn't exist"),
    "two outputs": (packages.connected(endConnector="x"), "joins output and output"),
    "types": (packages.connected(endConnector="inverted"), "between 'first.x' and 'second.inverted' feeds Boolean 'second.inverted' from Real 'first.x'"),
    "table": (packages.connected(TABLE), "has a table that is no line"),
    "calculated parameter": (packages.connected(endConnector="rate").replace('<ssd:Connector name="inverted" kind="input"/>', '<ssd:Connector name="rate" kind="parameter"/>'), "joins output and parameter; parameters are set before the run"),
    "factor": (packages.connected('<ssc:LinearTransformation factor="two"/>'), "has factor='two', which must be a number"),
    "not finite": (packages.connected('<ssc:LinearTransformation offset="INF"/>'), "has offset='INF', which must be finite"),
    "suppress": (packages.connected("", 'suppressUnitConversion="maybe"'), "must be true or false"),
    "connected twice": (changed(packages.CONNECTION, packages.CONNECTION * 2), "second.u is connected twice"),
    "stop time": (changed('stopTime="1"', 'stopTime="soon"'), "has stopTime='soon', which must be a number"),
    "unit factor": (changed('factor="0.001"', 'factor="0"'), "has factor='0'"),
    "unit exponent": (changed('s="1"', 's="half"'), "must be an integer"),
    "no binding": (packages.of_second(packages.binding()), "has neither a source nor a ParameterSet"),
    "missing set": (packages.of_second(packages.binding('source="values.ssv"')), "names 'values.ssv', which isn't in decays.ssp"),
    "set of another kind": (packages.of_second(packages.binding('type="text/csv" source="a.csv"')), "has the type 'text/csv'"),
    "set in an FMU": (packages.of_second(packages.binding('sourceBase="component" source="a.ssv"')), "from within an FMU"),
    "no value": (packages.of_second(packages.inline(packages.parameter_set(rate="Real"))), "<Real> of 'second' lacks the attribute 'value'"),
    "value": (packages.of_second(packages.inline(packages.parameter_set(rate='Real value="fast"'))), "value='fast', which must be a number"),
    "value not finite": (packages.of_second(packages.inline(packages.parameter_set(rate='Real value="NaN"'))), "must be finite"),
    "type of a value": (packages.of_second(packages.inline(packages.parameter_set(rate='Boolean value="true"'))), "is Boolean; 'rate' of resources/decay.fmu is Real"),
    "calculated": (packages.of_second(packages.inline(packages.parameter_set(steps='Integer value="1"'))), "which the FMU calculates"),
    "unit of a value": (packages.of_system(packages.inline(packages.parameter_set(second__x='Real value="1" unit="s"'))), "s can't be converted to m"),
    "no item": (packages.of_second(packages.inline(packages.parameter_set(trouble='Integer value="99"'))), "<Component name='second'>: trouble must be one of 1 (none), 2 (fails), "),
    "no boolean": (packages.of_second(packages.inline(packages.parameter_set(inverted='Boolean value="2"'))), "<Boolean> of 'second' has value='2', which must be true or false"),
    "item": (packages.of_second(packages.inline(packages.parameter_set(trouble='Enumeration value="maybe"'))), "<Component name='second'>: trouble must be one of none, fails, ends, forgets"),
    "mapping": (
        packages.of_second(packages.inline(packages.parameter_set(a='Real value="1"'), mapping=f"<ssd:ParameterMapping>{MAPPED}</ssd:ParameterMapping>")),
        "parameter 'a' is 1.0, which its mapping doesn't have",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_one_line(name: str, make_ssp: MakeSsp) -> None:
    """File, line and element are there where there is an element, and what is wrong with it."""
    ssd, problem = WRONG[name]
    message = refusal(make_ssp(ssd))
    assert problem in message
    if "<" in message and name not in ("another root",):
        assert "decays.ssp, SystemStructure.ssd, line " in message


def test_files_in_one_line(make_ssp: MakeSsp) -> None:
    """Where the line says nothing, the message still tells which component, and in which system."""
    head, tail = changed('<ssd:Component name="second"', f'{INNER}<ssd:Component name="second"').rsplit(
        "</ssd:Component>", 1
    )
    nested = f"{head}</ssd:Component></ssd:Elements></ssd:System>{tail}".replace(packages.CONNECTION, "")
    for ssd, problem in {
        nested.replace('"u"', '"x"'): "<Component name='second'> of 'inner' has two connectors named 'x'",
        nested.replace('"u" kind="input"', '"u" kind="inlet"'): "<Connector name='u'> of 'inner.second' has the kind",
        packages.connected(endConnector="v"): "<Connection> between 'first.x' and 'second.v' names the connector 'v'",
    }.items():
        message = refusal(make_ssp(" ".join(ssd.split("\n"))))
        assert ", line 1: " in message
        assert problem in message


def test_files_that_are_none(tmp_path: Path, make_ssp: MakeSsp) -> None:
    """No file, no zip, a zip of something else, an FMU that is none, one of another platform; and no step, which isn't guessed."""
    assert "can't read" in refusal(tmp_path / "nowhere.ssp")
    text = tmp_path / "text.ssp"
    text.write_text("hello")
    assert "not a zip file" in refusal(text)
    assert "holds no SystemStructure.ssd" in refusal(packages.package(tmp_path / "empty.ssp", {"a": "b"}))
    with pytest.raises(FmuFileError, match=r"resources/decay\.fmu is no FMU: not a zip file"):
        load_ssp(make_ssp(files={"resources/decay.fmu": "hello"}))
    step = r"names no step time, nor does any FMU in it; say it: .* --step SECONDS, load_ssp\(path, step=...\)"
    with pytest.raises(InputError, match=step):
        load_ssp(make_ssp())


LAUGHS = "<!ENTITY a0 'ha'>" + "".join(f"<!ENTITY a{i} '{f'&a{i - 1};' * 10}'>" for i in range(1, 10))


@pytest.mark.parametrize(
    ("entities", "reference"),
    [
        ('<!ENTITY secret SYSTEM "{uri}">', "&secret;"),
        ('<!ENTITY secret SYSTEM "{uri}">', ""),
        (LAUGHS, "&a2;"),
        (LAUGHS, "&a9;"),
    ],
    ids=["a file", "declared alone", "a hundred laughs, which libxml2 lets pass", "a billion laughs"],
)
def test_entities_are_not_read(entities: str, reference: str, make_ssp: MakeSsp, tmp_path: Path) -> None:
    """Neither files nor the net are touched, the secret is in no message, and nothing grows."""
    secret = tmp_path / "secret"
    secret.write_text("xyzzy")
    declared = packages.SSD.replace("?>", f"?><!DOCTYPE r [{entities.replace('{uri}', secret.as_uri())}]>")
    message = refusal(make_ssp(declared.replace("</ssd:Elements>", f"{reference}</ssd:Elements>")))
    assert "xyzzy" not in message
    assert "is no XML" in message or "has a document type declaration" in message


def test_nothing_leaves_the_archive(make_ssp: MakeSsp, make_decay: Callable[..., Path], tmp_path: Path) -> None:
    """Entries with names that lead elsewhere are errors, as is a component's path that does."""
    for name in ("../evil.fmu", "/tmp/evil-flexfmu.fmu", "resources/../../evil2.fmu", "C:evil.fmu", "..\\evil.fmu"):
        assert "which leaves its folder" in refusal(make_ssp(files={name: make_decay()}))
    path = make_ssp(changed("resources/decay.fmu", "resources/../../evil2.fmu"))
    assert "leads out of the archive" in refusal(path)
    assert not any(tmp_path.parent.rglob("evil*.fmu"))
    assert not Path("/tmp/evil-flexfmu.fmu").exists()


def test_bombs_are_not_unpacked(tmp_path: Path) -> None:
    """An SSD that unpacks to a hundred megabytes is refused by its ratio, and beside much else by its stated size."""
    path = tmp_path / "bomb.ssp"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", b" " * 100_000_000)
    assert "times its size, 100 MB" in refusal(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("resources/drawn", os.urandom(1_000_000))
    assert "at most 64000000 are read" in refusal(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
def test_a_damaged_archive(method: int, tmp_path: Path) -> None:
    """Wherever a byte of the file is wrong, the file is refused, or what is read is right all the same."""
    path = tmp_path / "damaged.ssp"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr(DESCRIPTION, packages.SSD)
    content, found = path.read_bytes(), []
    for i in range(0, len(content), 5):
        path.write_bytes(content[:i] + bytes([content[i] ^ 0xFF]) + content[i + 1 :])
        with suppress(SspError):
            found.append(SspArchive(path).read(DESCRIPTION))
    assert set(found) <= {packages.SSD.encode()}
    assert len(found) < 0.2 * len(content) / 5
