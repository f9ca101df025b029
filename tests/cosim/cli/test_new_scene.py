"""`flexfmu new` and `flexfmu scenes`: scene files to start from, whose comments are right."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer
from command_line import flexfmu

from flexfmu.cosim.cli.main import app
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import basis_hint, load_scene, read_scene_text, scene_path, shipped_scenes
from flexfmu.model.scene.keys import parse_setting
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.path import BLENDS
from flexfmu.trajectories.profiles import PROFILES

ROOT = Path(__file__).parents[3]

DEFAULT = re.compile(r"^# (\w+ = .*)$", re.M)
"""A key behind a #."""


def written(folder: Path, text: str) -> Scene:
    """The scene of a text."""
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path)


@pytest.mark.parametrize("name", shipped_scenes())
def test_new_writes_the_scene_under_the_name_of_its_file(name: str, tmp_path: Path) -> None:
    """Below the line for editors only the name differs from the shipped scene; all comments are there."""
    path = tmp_path / "my robot.toml"
    result = flexfmu("new", str(path), "--from", name)
    assert result.exit_code == 0
    assert load_scene(path) == load_scene(name).replace({"name": "my-robot"})
    text, shipped = path.read_text(encoding="utf-8"), read_scene_text(name)[0]
    _, _, text = text.partition("\n")  # the editors' line
    assert text == shipped.replace(f'name = "{name}"', 'name = "my-robot"')
    assert "run it with: flexfmu run" in result.stdout


def test_a_file_is_overwritten_by_force_alone(tmp_path: Path) -> None:
    """What is there stays."""
    path = tmp_path / "robot.toml"
    path.write_text("mine", encoding="utf-8")
    result = flexfmu("new", str(path))
    assert (result.exit_code, path.read_text(encoding="utf-8")) == (2, "mine")
    assert "--force" in result.stderr
    assert flexfmu("new", str(path), "--force").exit_code == 0
    assert load_scene(path).name == "robot"
    assert [each.name for each in tmp_path.iterdir()] == ["robot.toml"]


def test_a_new_scene_has_a_basis_for_any_robot(tmp_path: Path) -> None:
    """One mode each of three families, Craig-Bampton; the paper's basis, asked for by name, is warned of once the robot is another one."""
    path, paper = tmp_path / "robot.toml", tmp_path / "paper.toml"
    assert flexfmu("new", str(path)).exit_code == 0
    effects = load_scene(path).effects
    assert effects.basis == "craig-bampton"
    assert (effects.proximal_bending, effects.distal_axial, effects.distal_bending) == (1, 1, 1)
    assert flexfmu("new", str(paper), "--from", "barnard2012-0.1kg").exit_code == 0
    for file, changes, differs in (
        (path, {"payload.mass": 3.0, "mechanism.proximal.length": 0.25}, ""),
        (paper, {"trajectory.profile.kind": "poly5", "payload.mass": 6.0, "trajectory.duration": 0.43}, ""),
        (paper, {"effects.distal_bending": 1, "payload.mass": 3.0}, ""),
        (paper, {"effects.proximal_bending": 0, "effects.distal_axial": 0, "payload.mass": 3.0}, ""),
        (paper, {"mechanism.proximal.length": 0.25}, "mechanism.proximal"),
        (paper, {"mechanism.material.youngs_modulus": 210e9}, "mechanism.material.youngs_modulus"),
        (paper, {"payload.mass": 3.0}, "payload.mass"),
        (paper, {"trajectory.duration": 0.2}, "trajectory.duration"),
    ):
        hint = basis_hint(load_scene(file, changes))
        assert (f"`{differs}`" in hint) if differs else hint == "", changes
    # beside results; an error stays one line
    changes = ("effects.proximal_bending=1", "effects.distal_axial=0", "payload.mass=3")
    few = ("--json", *(word for each in changes for word in ("--set", each)))
    result = flexfmu("modes", str(paper), "--poses", "3", *few)
    assert json.loads(result.stdout)["poses"]
    assert "in `payload.mass`" in result.stderr
    assert "payload.mass" not in flexfmu("modes", str(paper), "--set", "trajectory.width=2.0", *few).stderr


def test_the_commands_of_the_page_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lists and new files are written in their order; of the others the scene, the settings and the options are right."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    lines = re.findall(r"^    flexfmu (.*)$", (ROOT / "docs" / "commands.md").read_text(encoding="utf-8"), re.M)
    assert len(lines) > 6
    for name, *arguments in (shlex.split(line, comments=True) for line in lines):
        if name in ("new", "scenes"):
            assert flexfmu(name, *arguments).exit_code == 0
            continue
        group: Any = typer.main.get_command(app)
        if name.startswith("--"):
            assert any(name in each.opts for each in group.params)
            continue
        command: Any = group.commands[name]
        given = command.make_context(name, arguments).params
        changes = dict(map(parse_setting, given["settings"] or ()))
        assert (load_scene(given["scene"], changes) != load_scene(given["scene"])) == bool(changes)


@pytest.mark.parametrize("name", shipped_scenes())
def test_each_key_behind_a_hash_has_its_default_value(name: str, tmp_path: Path) -> None:
    """Without its # a line is valid and changes nothing, in the sections; a wrong default or an old key shows."""
    text = read_scene_text(name)[0]
    head, found = text.partition("# Without the #")[0], 0
    for match in DEFAULT.finditer(head):
        found += 1
        changed = head[: match.start()] + match[1] + head[match.end() :]
        assert tomllib.loads(changed) != tomllib.loads(head)
        assert written(tmp_path, changed) == load_scene(name), match[1]
    assert found > 12


def test_the_optional_tables_are_valid(tmp_path: Path) -> None:
    """Without their # the tables of controllers, shaper and imperfection and the motors make a scene that torques drive."""
    text = read_scene_text(shipped_scenes()[0])[0].replace('drive = "motion"', 'drive = "torque"')
    head, sign, tail = text.partition("# Without the #")
    scene = written(tmp_path, head + sign + re.sub(r"^# (?=\[|\w+ = )", "", tail, flags=re.M))
    assert [each.kind for each in scene.controller] == ["pd", "feedforward"]
    assert [each.kind for each in scene.shaper] == ["zvd"]
    assert [each.kind for each in scene.imperfection] == ["encoder"]
    assert scene.motor is not None


UNKNOWN = r"must be '[^']+'.* or '[^']+', got '"
"""What an error says of a value that a key doesn't have."""


@pytest.mark.parametrize("name", shipped_scenes())
def test_every_key_has_a_comment_and_every_choice_is_named(name: str) -> None:
    """Each line with a key has a comment, kinds of blends and profiles are all there, and each of the values "a | b | c" behind a
    key of the sections is one that the key has, whatever else it needs."""
    text = read_scene_text(name)[0]
    keys = [line for line in text.splitlines() if re.match(r"\w+ = ", line)]
    assert len(keys) > 20
    assert [line for line in keys if " # " not in line] == []
    for kind in (*BLENDS, *PROFILES):
        assert re.search(rf"(?<![\w-]){kind}(?![\w-])", text)
    with pytest.raises(SceneError, match=UNKNOWN + "foo"):
        load_scene(name, {"cosimulation.initial": "foo"})
    section, found, unknown = "", 0, list[str]()
    for line in text.partition("# Without the #")[0].splitlines():
        section = match[1] if (match := re.match(r"\[(\w+)\]", line)) else section
        choices = re.match(r'(?:# )?(\w+) = "[\w-]+" +# ([\w-]+(?: \| [\w-]+)+)', line)
        for choice in choices[2].split(" | ") if choices else ():
            found += 1
            try:
                load_scene(name, {f"{section}.{choices[1]}": choice})
            except SceneError as error:
                unknown += re.findall(UNKNOWN + choice, str(error))
    assert unknown == []
    assert found > 15


def test_scenes_lists_the_shipped_ones() -> None:
    """Name, what it is, payload, duration and drive; the paths are in JSON and below the table."""
    result = flexfmu("scenes")
    found = json.loads(flexfmu("scenes", "--json").stdout)["scenes"]
    assert [each["name"] for each in found] == list(shipped_scenes())
    assert f"The files are in {scene_path(shipped_scenes()[0]).parent}\n" in result.stdout
    for each in found:
        scene = load_scene(each["name"])
        assert load_scene(each["path"]) == scene
        assert (each["payload_mass"], each["drive"]) == (scene.payload.mass, scene.cosimulation.drive)
        assert all(
            text in result.stdout for text in (each["name"], f"{each['payload_mass']:g} kg", each["description"])
        )
