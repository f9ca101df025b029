"""SSP files of the tests: two foreign FMUs in a row, x1' = rate (u - x1) and x2' = rate (x1 - x2), written by hand."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

NAMESPACES = " ".join(
    f'xmlns:{prefix}="http://ssp-standard.org/SSP1/SystemStructure{name}"'
    for prefix, name in zip(
        ("ssc", "ssd", "ssv", "ssm"), ("Common", "Description", "ParameterValues", "ParameterMapping"), strict=True
    )
)

CONNECTION = '<ssd:Connection startElement="first" startConnector="x" endElement="second" endConnector="u"/>'

SSD = f"""<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription {NAMESPACES} version="1.0" name="decays">
  <ssd:System name="row">
    <ssd:Elements>
      <ssd:Component name="first" source="resources/decay.fmu">
        <ssd:Connectors>
          <ssd:Connector name="x" kind="output"><ssc:Real unit="m"/></ssd:Connector>
          <ssd:Connector name="steps" kind="output"><ssc:Integer/></ssd:Connector>
        </ssd:Connectors>
      </ssd:Component>
      <ssd:Component name="second" source="resources/decay.fmu">
        <ssd:Connectors>
          <ssd:Connector name="u" kind="input"><ssc:Real/></ssd:Connector>
          <ssd:Connector name="x" kind="output"/>
          <ssd:Connector name="inverted" kind="input"/>
        </ssd:Connectors>
      </ssd:Component>
    </ssd:Elements>
    <ssd:Connections>
      {CONNECTION}
    </ssd:Connections>
  </ssd:System>
  <ssd:Units>
    <ssc:Unit name="m"><ssc:BaseUnit m="1"/></ssc:Unit>
    <ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit>
    <ssc:Unit name="s"><ssc:BaseUnit s="1"/></ssc:Unit>
  </ssd:Units>
  <ssd:DefaultExperiment startTime="0" stopTime="1"/>
</ssd:SystemStructureDescription>
"""


def parameter_set(**values: str) -> str:
    """A parameter set of typed values, ``Real value="2"`` for example; a dot in a name is written ``__``."""
    inner = "".join(
        f'<ssv:Parameter name="{name.replace("__", ".")}"><ssv:{value}/></ssv:Parameter>'
        for name, value in values.items()
    )
    return f'<ssv:ParameterSet {NAMESPACES} version="1.0" name="set"><ssv:Parameters>{inner}</ssv:Parameters></ssv:ParameterSet>'


def binding(attributes: str = "", content: str = "") -> str:
    """Parameter bindings of one set."""
    return f"<ssd:ParameterBindings><ssd:ParameterBinding {attributes}>{content}</ssd:ParameterBinding></ssd:ParameterBindings>"


def inline(values: str, attributes: str = "", mapping: str = "") -> str:
    """The binding of a set that is written inline."""
    return binding(attributes, f"<ssd:ParameterValues>{values}</ssd:ParameterValues>{mapping}")


def of_second(bindings: str, ssd: str = SSD) -> str:
    """The system with parameter bindings of the second component."""
    head, tail = ssd.rsplit("</ssd:Connectors>", 1)
    return f"{head}</ssd:Connectors>{bindings}{tail}"


def of_system(bindings: str, ssd: str = SSD) -> str:
    """The system with parameter bindings of its own."""
    return ssd.replace("<ssd:Elements>", f"{bindings}<ssd:Elements>", 1)


def connected(inner: str = "", attributes: str = "", ssd: str = SSD, **ends: str) -> str:
    """The system with another connection; ``ends`` are changed attributes, left out where empty."""
    found = {"startElement": "first", "startConnector": "x", "endElement": "second", "endConnector": "u"} | ends
    named = " ".join(f'{name}="{value}"' for name, value in found.items() if value)
    return ssd.replace(CONNECTION, f"<ssd:Connection {named} {attributes}>{inner}</ssd:Connection>")


def package(path: Path, files: Mapping[str, bytes | str | Path]) -> Path:
    """Zip texts and files."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content.read_bytes() if isinstance(content, Path) else content)
    return path
