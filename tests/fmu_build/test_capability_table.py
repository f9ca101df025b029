"""The table of capabilities in the documentation says of our FMUs what their descriptions say."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import pytest

from flexfmu.fmu_build.description import description_xml
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.sources import plant_description
from flexfmu.fmu_build.toolchain import PLATFORMS
from flexfmu.model.symbolic import SymbolicModel

DOCUMENT = Path(__file__).parents[2] / "docs" / "fmu.md"

ELEMENTS = {"co-simulation": ("CoSimulation",), "model exchange": ("ModelExchange",)}
COSIMULATION_ALONE = {"canHandleVariableCommunicationStepSize", "canInterpolateInputs", "maxOutputDerivativeOrder"}


@pytest.fixture
def ours() -> dict[str, str]:
    """Capability → what the table says of flexfmu."""
    if not DOCUMENT.is_file():
        pytest.skip("tests run away from the source tree")
    text = DOCUMENT.read_text(encoding="utf-8").partition("\n## Capabilities")[2]
    rows = [line.split("|") for line in text.splitlines() if line.startswith("| ")]
    header, *cells = ([cell.strip() for cell in row[1:-1]] for row in rows)
    assert header[:2] == ["Capability", "flexfmu"]
    assert all(len(row) == len(header) and all(row) for row in cells)
    return {row[0]: row[1] for row in cells}


@pytest.fixture
def description(make_oscillators: Callable[..., SymbolicModel]) -> ElementTree.Element:
    """Model description of a plant, parsed."""
    text = description_xml(plant_description(make_oscillators()), "{1}", DefaultExperiment(), ("model.c",))
    return ElementTree.fromstring(text.encode())


def test_claimed_attributes_are_those_of_our_descriptions(
    ours: dict[str, str], description: ElementTree.Element
) -> None:
    """Every row that names an attribute has the value that our FMUs have, for the interface that it names or for both."""
    checked = 0
    for capability, value in ours.items():
        if not capability.startswith("`"):
            continue
        attribute, _, interface = capability.replace("`", "").partition(", ")
        both = ("CoSimulation",) if attribute in COSIMULATION_ALONE else ("CoSimulation", "ModelExchange")
        for name in ELEMENTS.get(interface, both):
            element = description.find(name)
            assert element is not None
            assert element.get(attribute, "not set") == value, capability
            checked += 1
    assert checked >= 15


def test_other_claims_hold_too(ours: dict[str, str], description: ElementTree.Element) -> None:
    """Interfaces, units, categories and sources are there; platforms are those that can be built for."""
    assert description.get("fmiVersion") == "2.0"
    claims = {
        "Co-simulation, FMI 2.0": "CoSimulation",
        "Model exchange, FMI 2.0": "ModelExchange",
        "Units": "UnitDefinitions/Unit",
        "Log categories": "LogCategories/Category",
        "Sources to build from": "CoSimulation/SourceFiles/File",
    }
    for capability, path in claims.items():
        assert ours[capability] == "yes"
        assert description.find(path) is not None, capability
    assert ours["Platforms from one machine"] == ", ".join(PLATFORMS)
