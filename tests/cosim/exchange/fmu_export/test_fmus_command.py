"""`flexfmu fmus`: where the FMUs go and what is said about them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from flexfmu.cosim.cli.main import app
from flexfmu.fmu_build.validation.validate import validate_fmu

CONTROLLED = """
[[controller]]
kind = "pd"
proportional = 2e3
derivative = 20.0
sample_time = 1e-3
[[controller]]
kind = "feedforward"
name = "ahead"
sample_time = 1e-3
"""


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    """A scene with two controllers."""
    shipped = Path(__file__).parents[4] / "model" / "scene" / "scenes" / "barnard2012-6kg.toml"
    path = tmp_path / "controlled.toml"
    text = shipped.read_text(encoding="utf-8").replace('drive = "motion"', 'drive = "torque"')
    path.write_text(text + CONTROLLED, encoding="utf-8")
    return path


def fmus(*arguments: object) -> Result:
    """Run the command."""
    return CliRunner().invoke(app, ["fmus", *map(str, arguments)])


@pytest.mark.slow
def test_all_slaves_of_a_scene(scene_file: Path, tmp_path: Path) -> None:
    """Valid FMUs by the slaves' names; the JSON says where they are and how they are connected."""
    result = fmus(scene_file, "--out", tmp_path / "out", "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert [each["name"] for each in found["slaves"]] == ["trajectory", "plant", "pd", "ahead"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"{each['name']}.fmu" for each in found["slaves"]}
    assert {"from": "ahead.joint1.feedforward", "to": "pd.joint1.feedforward"} in found["connections"]
    assert validate_fmu(Path(found["slaves"][3]["fmu"])) == []


def test_some_slaves_of_a_scene(scene_file: Path, tmp_path: Path) -> None:
    """A table with a line for each; a name that isn't there is a mistake of usage that tells the others."""
    result = fmus(scene_file, "--out", tmp_path / "out", "--slave", "pd", "--slave", "ahead")
    assert result.exit_code == 0, result.stderr
    assert "pd.fmu" in result.stdout
    assert "0.001 s" in result.stdout
    assert "2 FMUs" in result.stdout
    flat = fmus(
        scene_file, "--out", tmp_path / "flat", "--slave", "pd", "--slave", "ahead", "--naming", "flat", "--json"
    )
    ends = {"from": "ahead.joint1_feedforward", "to": "pd.joint1_feedforward"}
    assert ends in json.loads(flat.stdout)["connections"]
    wrong = fmus(scene_file, "--out", tmp_path / "out", "--slave", "pid")
    assert wrong.exit_code == 2
    assert "slaves: trajectory, plant, pd, ahead" in wrong.stderr
