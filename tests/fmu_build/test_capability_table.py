"""The table of capabilities in the documentation says of our FMUs what their descriptions say."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import pytest

from flexfmu.fmu_build.description import description_xml
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.source_generation import plant_description
from flexfmu.fmu_build.toolchain import PLATFORMS
from flexfmu.model.symbolic import SymbolicModel

DOCUMENT = Path(__file__).parents[2] / "docs" / "fmu.md"

INTERFACES = {"co-simulation": "CoSimulation", "model exchange": "ModelExchange"}
COSIMULATION_ALONE = {"canHandleVariableCommunicationStepSize", "canInterpolateInputs", "maxOutputDerivativeOrder"}
CLAIMS = {
    "Co-simulation, FMI 2.0": "CoSimulation",
    "Model exchange, FMI 2.0": "ModelExchange",
    "Units": "UnitDefinitions/Unit",
    "Log categories": "LogCategories/Category",
    "Sources to build from": "CoSimulation/SourceFiles/File",
}


@pytest.mark.skipif(not DOCUMENT.is_file(), reason="tests run away from the source tree")
def test_claims_are_those_of_our_descriptions(make_oscillators: Callable[..., SymbolicModel]) -> None:
    """Every row that names an attribute has the value that our FMUs have, for the interface that it names or for all that have it;
    other claims have their elements; platforms are those that can be built for."""
    table = DOCUMENT.read_text(encoding="utf-8").partition("\n## Capabilities")[2]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines() if line.startswith("| ")]
    assert rows[0][:2] == ["Capability", "flexfmu"]
    assert all(len(row) == len(rows[0]) and all(row) for row in rows)
    ours = {row[0]: row[1] for row in rows[1:]}
    text = description_xml(plant_description(make_oscillators()), "{1}", DefaultExperiment(), ("model.c",))
    description = ElementTree.fromstring(text.encode())

    attributes = [name for name in ours if name.startswith("`")]
    assert len(attributes) >= 10
    for name in attributes:
        attribute, _, interface = name.replace("`", "").partition(", ")
        both = ("CoSimulation",) if attribute in COSIMULATION_ALONE else (*INTERFACES.values(),)
        elements = [description.find(each) for each in ((INTERFACES[interface],) if interface else both)]
        assert {each.get(attribute, "not set") for each in elements if each is not None} == {ours[name]}, name
    assert description.get("fmiVersion") == "2.0"
    assert {claim: ours[claim] for claim in CLAIMS} == dict.fromkeys(CLAIMS, "yes")
    assert [path for path in CLAIMS.values() if description.find(path) is None] == []
    assert ours["Platforms from one machine"] == ", ".join(PLATFORMS)
