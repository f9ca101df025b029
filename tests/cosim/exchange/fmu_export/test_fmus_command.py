"""`flexfmu fmus`: where the FMUs go and what is said about them."""

from __future__ import annotations

import json
from pathlib import Path

import tomlkit
from typer.testing import CliRunner, Result

from flexfmu.cosim.cli.main import app
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.model.scene.file import load_scene

TIME = {"sample_time": 1e-3}
CONTROLLED = {
    "cosimulation.drive": "torque",
    "controller": [
        {"kind": "pd", "proportional": 2e3, "derivative": 20.0, **TIME},
        {"kind": "feedforward", "name": "ahead", **TIME},
    ],
}


def fmus(*arguments: object) -> Result:
    """Run the command."""
    return CliRunner().invoke(app, ["fmus", *map(str, arguments)])


def test_slaves_of_a_scene(tmp_path: Path) -> None:
    """A table with a line for each, or JSON that says where they are and how they are connected; a name that isn't there is a
    mistake of usage that tells the others."""
    scene = tmp_path / "controlled.toml"
    scene.write_text(tomlkit.dumps(load_scene("barnard2012-6kg").replace(CONTROLLED).model_dump(exclude_none=True)))
    chosen = (scene, "--out", tmp_path / "out", "--slave", "pd", "--slave", "ahead")
    result = fmus(*chosen)
    assert result.exit_code == 0, result.stderr
    for part in ("pd.fmu", "0.001 s", "2 FMUs"):
        assert part in result.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"pd.fmu", "ahead.fmu"}
    for naming, dot in (("structured", "."), ("flat", "_")):
        found = json.loads(fmus(*chosen, "--naming", naming, "--json").stdout)
        assert {"from": f"ahead.joint1{dot}feedforward", "to": f"pd.joint1{dot}feedforward"} in found["connections"]
        assert [each["name"] for each in found["slaves"]] == ["pd", "ahead"]
        assert validate_fmu(Path(found["slaves"][1]["fmu"])) == []
    wrong = fmus(scene, "--out", tmp_path / "out", "--slave", "pid")
    assert wrong.exit_code == 2
    assert "slaves: trajectory, plant, pd, ahead" in wrong.stderr
