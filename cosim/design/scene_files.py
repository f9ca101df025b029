"""Scene files with some values changed: everything else, comments included, stays."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import tomlkit

from flexfmu.cosim.engine.files import write_whole
from flexfmu.model.scene.file import load_scene, read_scene_text
from flexfmu.model.scene.keys import set_value
from flexfmu.model.scene.schema import Scene


def changed_document(source: str | Path, target: Path, changes: Mapping[str, Any]) -> tomlkit.TOMLDocument:
    """Return a scene file with changed values, whose relative paths are relative to the folder of another file.

    Args:
        source: path of the scene file, or name of a shipped scene.
        target: the file that it will be written to.
        changes: dotted key → value.

    Raises:
        SceneError: there is no such scene, or no such key.
    """
    text, label, folder = read_scene_text(source)
    document = tomlkit.parse(text)
    for key, value in changes.items():
        set_value(document, key, toml_item(value), label)
    # paths of files that tables name
    arrays = [each for each in document.values() if isinstance(each, list)]
    tables: list[Any] = [
        document["trajectory"],
        *(each for array in arrays for each in array if isinstance(each, dict)),
    ]
    for table in tables:
        place = {"fmu": "path", "python": "folder", "table": "file"}.get(table.get("kind"))
        if place is not None and folder is not None:
            table[place] = os.path.relpath(folder / table.get(place, "."), target.resolve().parent)
    return document


def write_changed(source: str | Path, target: Path, changes: Mapping[str, Any]) -> Path:
    """Write a scene file with changed values, and read it again; arguments and errors as for `changed_document`.

    Raises:
        ResultsError: the file can't be written.
    """
    write_whole(target, tomlkit.dumps(changed_document(source, target, changes)))
    load_scene(target)
    return target


def write_new(
    scene: Scene, target: Path, comments: Iterable[str] = (), sections: Mapping[str, Any] = MappingProxyType({})
) -> Path:
    """Write a scene file of its own, with comments on top, and read it again.

    Args:
        scene: the scene, of which the file has what isn't a default.
        target: the new file.
        comments: lines.
        sections: what the file has in place of sections of the scene.

    Raises:
        ResultsError: the file can't be written.
    """
    data = scene.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    if scene.effects.choice is not None and None in scene.effects.choice.error:
        del data["effects"]["choice"]  # TOML has no null for errors that aren't estimated
    document = tomlkit.document()
    for line in comments:
        document.add(tomlkit.comment(line))
    if comments:
        document.add(tomlkit.nl())
    for key, value in {**data, **sections}.items():
        document.add(key, toml_item(value))
    write_whole(target, tomlkit.dumps(document))
    load_scene(target)
    return target


def toml_item(value: Any) -> Any:
    """Return a value for TOML: sections below the first level in one line."""
    if isinstance(value, dict):
        table = tomlkit.table()
        for key, each in value.items():
            table.add(key, _inline(each))
        return table
    if isinstance(value, list) and value and isinstance(value[0], dict):
        tables = tomlkit.aot()
        for each in value:
            tables.append(toml_item(each))
        return tables
    return value


def _inline(value: Any) -> Any:
    if isinstance(value, dict):
        table = tomlkit.inline_table()
        table.update({key: _inline(each) for key, each in value.items()})
        return table
    return [_inline(each) for each in value] if isinstance(value, list) else value
