"""Other people's checkers find nothing in what we describe, and do find what somebody spoils."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Collection
from pathlib import Path

import pytest
from fmpy.validation import validate_fmu
from third_party_support.drawn import SHIPPED
from third_party_support.tools import class_path, python_tool, run

from flexfmu.fmu_build.archive import pack

pytestmark = pytest.mark.slow

DRIVER = Path(__file__).parent / "java" / "CheckDescriptions.java"


def vdmcheck(model: str, paths: Collection[Path], folder: Path) -> list[str]:
    """What one of VDMCheck2's formal models of the standard finds in descriptions, one line each; one JVM for all."""
    jars = class_path("vdmcheck")
    output = run(["java", "-XX:TieredStopAtLevel=1", "-cp", jars, str(DRIVER), model, *map(str, paths)], folder)
    *findings, last = output.strip().splitlines()
    assert last == f"checked {len(paths)}"
    return findings


def fmutool(path: Path) -> list[str]:
    """What `fmutool -check` (FMU manipulation toolbox) logs as errors about an FMU."""
    toolbox = python_tool("fmu_manipulation_toolbox.operations")
    checkers = python_tool("fmu_manipulation_toolbox.checker").get_checkers()
    messages: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(record.getMessage())

    logger, listener = logging.getLogger("fmu_manipulation_toolbox"), Listener(logging.ERROR)
    logger.addHandler(listener)
    try:
        for checker in checkers:
            toolbox.FMU(str(path)).apply_operation(checker())
    finally:
        logger.removeHandler(listener)
    return messages


def as_fmu(description: str, folder: Path) -> Path:
    """An archive of a model description alone."""
    path = folder / "described.fmu"
    path.write_bytes(pack({"modelDescription.xml": description.encode()}))
    return path


def test_many_scenes_are_described(described: dict[str, Path]) -> None:
    """Both drives, and more than twenty models."""
    texts = [path.read_text(encoding="utf-8") for path in described.values()]
    assert len(texts) >= 20
    assert sum("joint1.reference.position" in text for text in texts) >= 5
    assert sum('name="joint1.torque" valueReference="0" causality="input"' in text for text in texts) >= 3


def test_vdmcheck_finds_what_is_spoilt_and_nothing_else(described: dict[str, Path], tmp_path: Path) -> None:
    """The standard as a formal model, rule by rule; for the shipped scenes, its older form too. A parameter that varies
    continuously breaks a rule that no schema knows."""
    assert vdmcheck("rules", described.values(), tmp_path) == []
    assert vdmcheck("static", [described[name] for name in SHIPPED], tmp_path) == []
    text, spoilt = described["barnard2012-6kg"].read_text(encoding="utf-8"), tmp_path / "spoilt.xml"
    pattern = r'causality="parameter" variability="\w+"'
    spoilt.write_text(re.sub(pattern, 'causality="parameter" variability="continuous"', text), encoding="utf-8")
    assert vdmcheck("rules", [spoilt], tmp_path) != []


CHECKS: dict[str, Callable[[Path], list[str]]] = {"fmpy": lambda path: validate_fmu(str(path)), "fmutool": fmutool}


@pytest.mark.parametrize("tool", CHECKS)
def test_python_tools_find_what_is_spoilt_and_nothing_else(
    tool: str, described: dict[str, Path], tmp_path: Path
) -> None:
    """Schema, model structure and initial unknowns, combinations of attributes and references between variables; an output that
    the model structure leaves out."""
    check, texts = CHECKS[tool], {name: path.read_text(encoding="utf-8") for name, path in described.items()}
    found = {name: check(as_fmu(text, tmp_path)) for name, text in texts.items()}
    assert {name: problems for name, problems in found.items() if problems} == {}
    spoilt = re.sub(r"(<Outputs>\s*)<Unknown [^>]*/>", r"\1", texts["barnard2012-6kg"], count=1)
    assert check(as_fmu(spoilt, tmp_path)) != []
