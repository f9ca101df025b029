"""Numbered choices of our own FMUs are set by name, whatever the importer sees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy import read_model_description

from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import settable_variables, settings
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.fmu_build.archive import pack
from flexfmu.model.scene.file import load_scene


@pytest.fixture(scope="module")
def robot() -> Path:
    """The FMU of a shipped scene."""
    return build_scene(load_scene("barnard2012-6kg")).path


@pytest.mark.parametrize(("parameters", "numbers"), [
    ({"initial": "static", "integrator": "automatic"}, [1, 1]),
    ({"initial": "undeformed", "integrator": "radau3"}, [2, 5]),
    ({"initial": 2, "integrator": 7}, [2, 7]),
])  # fmt: skip
def test_names_stand_for_numbers(robot: Path, parameters: dict[str, int | str], numbers: list[int]) -> None:
    """A script says what it means; importers without the names give the numbers."""
    found = settings(settable_variables(open_fmu(robot).description), parameters)
    assert [setting.value for setting in found] == numbers
    assert {setting.handle.kind for setting in found} == {"Integer"}


def items_of(variable: Any) -> dict[str, int]:
    """Names and numbers of an enumeration."""
    return {item.name: int(item.value) for item in variable.declaredType.items}


def test_choices_are_enumerations_on_request(tmp_path: Path) -> None:
    """The same numbers behind names that every tool with enumerations shows; fmpy finds nothing wrong."""
    scene = load_scene("barnard2012-6kg")
    path = build_scene(scene, enumerations=True, output=tmp_path / "enumerations.fmu").path
    variables = {each.name: each for each in read_model_description(str(path), validate=True).modelVariables}
    items = items_of(variables["integrator"])
    assert (variables["integrator"].type, items["radau3"], items["rk4"]) == ("Enumeration", 5, 7)
    found = settings(settable_variables(open_fmu(path).description), {"initial": "undeformed", "integrator": 5})
    assert [setting.value for setting in found] == [2, 5]
    starts = {"initial": items_of(variables["initial"])["undeformed"]}
    result = fmpy.simulate_fmu(str(path), stop_time=1e-3, start_values=starts, output=["link11.bending[1]"])
    assert result["link11.bending[1]"][0] == 0.0


def test_wrong_choices_are_refused(robot: Path, tmp_path: Path) -> None:
    """Before anything runs, with what would be right; an annotation that somebody spoilt is no reason to set something else."""
    for parameters, message in (
        ({"initial": "sttic"}, "initial must be one of static, undeformed, got 'sttic'"),
        ({"integrator": 8}, "integrator must be at least 1 and at most 7, got 8"),
        ({"payload.mass": "static"}, "payload.mass is a number, got 'static'"),
    ):
        with pytest.raises(InputError, match=message):
            FmuSlave(robot, parameters=parameters)
    folder = open_fmu(robot).folder
    files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    text = files["modelDescription.xml"].decode().replace("static=1", "static=one")
    spoilt = tmp_path / "spoilt.fmu"
    spoilt.write_bytes(pack(files | {"modelDescription.xml": text.encode()}))
    with pytest.raises(FmuFileError, match="its Choices are"):
        FmuSlave(spoilt)
