"""`flexfmu scenes`, `new` and `schema`: the shipped scenes, a scene file to start from, and what editors need to complete one."""

from __future__ import annotations

import re
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from flexfmu.cosim.cli.console import check_scene_file, print_result, print_text, show_note
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import write_whole

if TYPE_CHECKING:
    from rich.table import Table


USUAL = "starter"
"""The scene that `new` starts from."""


def scenes(json: bool = False) -> int:
    """List the scenes that come with flexfmu, which every command takes by their names."""
    from flexfmu.model.scene.file import scene_path, shipped_scenes

    found = [_facts(name) for name in shipped_scenes()]
    copied = "A copy to change: flexfmu new FILE.toml --from NAME"
    print_result(json, {"scenes": found}, _table(found), copied, f"The files are in {scene_path(USUAL).parent}")
    return 0


def _facts(name: str) -> dict[str, Any]:
    """What `--json` prints of a shipped scene."""
    from flexfmu.model.scene.file import load_scene, read_scene_text, scene_path

    scene = load_scene(name)
    # the first sentence of the file says what it is
    sentence = read_scene_text(name)[0].partition(". ")[0].removeprefix("# ")
    return {
        "name": name,
        "description": " ".join(sentence.replace("\n#", " ").split()),
        "payload_mass": scene.payload.mass,
        "duration": scene.trajectory.duration,
        "drive": scene.cosimulation.drive,
        "path": str(scene_path(name)),
    }


def _table(found: list[dict[str, Any]]) -> Table:
    """A line for each scene."""
    from rich.table import Column

    from flexfmu.cosim.reports.terminal import titled_table

    payload, duration = Column("payload", justify="right"), Column("duration", justify="right")
    table = titled_table("", "scene", "what it is", payload, duration, "drive")
    for each in found:
        figures = f"{each['payload_mass']:g} kg", f"{each['duration']:g} s"
        table.add_row(each["name"], each["description"], *figures, each["drive"])
    return table


def new(file: Path, origin: str = USUAL, force: bool = False, json: bool = False) -> int:
    """Write a scene file to start from: complete, with units, choices and defaults as comments.

    Args:
        file (FILE.toml): The file to write.
        origin (--from NAME): A shipped scene to start from; flexfmu scenes lists them.
        force: Overwrite the file if there is one. Default: refuse.
    """
    from flexfmu.model.scene.file import read_scene_text, scene_path, shipped_scenes

    # usage
    check_scene_file(file)
    if origin not in shipped_scenes():
        raise InputError(f"--from takes a shipped scene, {' or '.join(shipped_scenes())}, got {origin}")
    if file.exists() and not force:
        raise InputError(f"{file} is there already: give another name, or --force to overwrite it")
    if not file.parent.is_dir():
        raise InputError(f"there is no folder {file.parent} for {file.name}: create it, or give another path")
    # the scene is called like its file, with the letters that names may have
    name = re.sub(r"[^\w.+-]", "-", file.stem)
    name = name if re.search(r"\w", name) else "scene"
    text = read_scene_text(origin)[0]
    text = re.sub(r'^name = ".*?"', f'name = "{name}"', text, count=1, flags=re.MULTILINE)
    # the first line lets editors complete keys and show their units
    schema = scene_path(origin).parents[1] / "scene.schema.json"
    file.write_text(f"#:schema {schema.as_uri()}\n{text}", encoding="utf-8")
    data = {"path": str(file), "name": name, "from": origin}
    print_result(json, data, f"{file}: the scene {origin} as {name}; run it with: flexfmu run {quote(str(file))}")
    return 0


def schema(output: Path | None = None) -> int:
    """JSON Schema of scene files, by which editors complete keys and show their units.

    Editors with taplo (Even Better TOML) read it where a scene file begins with a line [i]#:schema ./scene.schema.json[/i].

    Args:
        output (-o, --output FILE.json): File to write. Default: standard output.
    """
    from flexfmu.model.scene.file import scene_schema

    text = scene_schema()
    if output is None:
        print_text(text)
        return 0
    write_whole(output, text)
    show_note(f"{output}: a scene file beside it begins with the line  #:schema ./{output.name}")
    return 0
