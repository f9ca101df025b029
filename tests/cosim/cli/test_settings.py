"""``--set KEY=VALUE``: keys of a scene that change for one command."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import typer
from command_line import flexfmu

from flexfmu.cosim.cli.console import usual_folder
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.design.shapers.recommendation import write_shaped
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.keys import parse_setting

SCENE = "barnard2012-6kg"
EXAMPLE = Path(__file__).parents[3] / "examples" / "controller_scene.toml"


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        ("payload.mass=3", "payload.mass", 3),
        (" payload.mass = 3e-1 ", "payload.mass", 0.3),
        ("payload.mass=.5", "payload.mass", 0.5),
        ("effects.gravity=[0.0, 9.81]", "effects.gravity", [0.0, 9.81]),
        ("cosimulation.drive=torque", "cosimulation.drive", "torque"),
        ('cosimulation.drive="torque"', "cosimulation.drive", "torque"),
        ("effects.reactions=true", "effects.reactions", True),
        ('effects.damping={kind="modal",ratio=0.1}', "effects.damping", {"kind": "modal", "ratio": 0.1}),
        ("controller.pd.source=a:b", "controller.pd.source", "a:b"),
    ],
)
def test_a_setting_is_a_key_and_a_value_of_toml(text: str, key: str, value: Any) -> None:
    """Numbers, texts with and without quotes, lists, tables and truth values."""
    found = parse_setting(text)
    assert found == (key, value)
    assert type(found[1]) is type(value)


def test_changes_are_as_if_they_stood_in_the_file(tmp_path: Path) -> None:
    """Sections, arrays by index, and controllers by their kind: the same scene as with `replace`. A file may be complete with
    the settings alone."""
    changes = {
        "payload.mass": 2.5,
        "effects.gravity[1]": -1.62,
        "controller[0].proportional": [4e3, 5e3],
        "controller.feedforward.payload": 5.0,
        "trajectory.profile.kind": "poly5",
    }
    changed = load_scene(EXAMPLE, changes)
    assert changed == load_scene(EXAMPLE).replace(changes)
    assert changed.effects.gravity == (0.0, -1.62)
    assert changed != load_scene(EXAMPLE)
    incomplete = tmp_path / "incomplete.toml"
    incomplete.write_text(EXAMPLE.read_text(encoding="utf-8").replace("duration = 0.43\n", ""), encoding="utf-8")
    with pytest.raises(SceneError, match="duration"):
        load_scene(incomplete)
    assert load_scene(incomplete, {"trajectory.duration": 0.5}).trajectory.duration == 0.5


def test_every_command_with_a_scene_can_change_it() -> None:
    """The commands whose first argument is a scene have the option, and the help names it."""
    group: Any = typer.main.get_command(app)
    single = {
        name: [option for each in command.params for option in each.opts]
        for name, command in group.commands.items()
        if any(each.name == "scene" and each.nargs == 1 for each in command.params)
    }
    assert {"run", "build", "fmus", "export", "modes", "effects", "shaper", "workprec", "sweep"} <= single.keys()
    assert [name for name, options in single.items() if "--set" not in options and name != "new"] == []


@pytest.mark.slow
def test_results_of_a_changed_scene_leave_the_others_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each run has a folder of its own, and says in its titles what was changed."""
    monkeypatch.chdir(tmp_path)
    few = ("--no-verify", "--set", "trajectory.dwell=0")
    for more in ((), ("--set", "payload.mass=3"), ("--set", "payload.mass=4")):
        result = flexfmu("run", SCENE, *few, *more)
        assert result.exit_code == 0, result.stderr
        title = ", ".join([SCENE, "trajectory.dwell=0", *more[1:]])
        assert title in " ".join(result.stdout.split())
    folders = sorted((tmp_path / "results").iterdir())
    ends = ["", "_payload.mass=3", "_payload.mass=4"]
    assert [each.name for each in folders] == [f"{SCENE}-trajectory.dwell=0{end}" for end in ends]
    summaries = [json.loads((each / "summary.json").read_text(encoding="utf-8")) for each in folders]
    assert [each["scene"]["payload"]["mass"] for each in summaries] == [6.0, 3.0, 4.0]
    assert summaries[1]["changes"] == ["trajectory.dwell=0", "payload.mass=3"]
    assert "<h1>barnard2012-6kg, trajectory.dwell=0, payload.mass=3</h1>" in (folders[1] / "report.html").read_text(
        encoding="utf-8"
    )


def test_folders_of_changes() -> None:
    """Without changes the name alone; texts, arrays and many changes give names that every system can have, different ones each."""
    assert usual_folder("a", None) == usual_folder("a", ()) == Path("results/a")
    assert usual_folder("a", None, "-plan") == Path("results/a-plan")
    assert usual_folder("a", ["payload.mass=3"], "-plan") == Path("results/a-plan-payload.mass=3")
    many = [[f"effects.gravity=[{x},0]", f"trajectory.profile={{ kind = '{'poly7' * 20}' }}"] for x in range(20)]
    names = {usual_folder("a", each).name for each in many}
    assert len(names) == 20
    assert all(re.fullmatch(r"[\w.+=-]{1,100}", name) for name in names)


def test_a_written_shaped_scene_keeps_the_changes(tmp_path: Path) -> None:
    """`flexfmu shaper --set ... -o FILE.toml`: the file has the changed values, and its comments."""
    target = tmp_path / "shaped.toml"
    changes = {"payload.mass": 2.5, "controller[0].derivative": 60.0, "effects.gravity": [0.0, 0.0]}
    write_shaped(
        str(EXAMPLE), {"kind": "zv", "modes": [{"frequency": 58.0, "ratio": 0.1}], "apply": "joints"}, target, changes
    )
    written = load_scene(target)
    assert written.shaper[0].kind == "zv"
    assert written.replace({"shaper": ()}) == load_scene(EXAMPLE, changes).replace({"shaper": ()})
    assert "# rigid inverse dynamics" in target.read_text(encoding="utf-8")
