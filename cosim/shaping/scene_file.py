"""A recommended shaper as TOML: the table that applies it, and the scene file with it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from flexfmu.cosim.errors import ResultsError
from flexfmu.model.scene_file import load_scene, read_scene_text


def shaper_toml(section: Mapping[str, Any]) -> str:
    """The `[[shaper]]` table of these keys; empty for no keys."""
    if not section:
        return ""
    document = tomlkit.document()
    document.append("shaper", _tables(section))
    return tomlkit.dumps(document)


def write_shaped(source: str, section: Mapping[str, Any], target: Path) -> None:
    """Write a scene file with this shaper in place of its own ones; comments and order of the rest stay.

    Args:
        source: path of a scene file, or name of a shipped scene.
        section: keys of the shaper; without any the scene is written without shapers.
        target: the new file; paths in the scene are rewritten to count from its folder.

    Raises:
        ResultsError: the file can't be written.
    """
    text, _, folder = read_scene_text(source)
    document = tomlkit.parse(text)
    document.pop("shaper", None)
    for table in (*document.get("controller", ()), *document.get("imperfection", ())):
        key = {"fmu": "path", "python": "folder"}.get(table["kind"])
        if key is not None and folder is not None:
            table[key] = os.path.relpath(folder / table.get(key, "."), target.resolve().parent)
    if section:
        document.append("shaper", _tables(section))
    try:
        target.write_text(tomlkit.dumps(document), encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"can't write {target}: {error.strerror or error}; choose another file") from error
    load_scene(target)


def _tables(section: Mapping[str, Any]) -> tomlkit.items.AoT:
    """An array of one table, modes as inline tables."""
    table = tomlkit.table()
    for key, value in section.items():
        table.append(key, _modes(value) if key == "modes" else value)
    tables = tomlkit.aot()
    tables.append(table)
    return tables


def _modes(modes: Any) -> tomlkit.items.Array:
    """One mode a line."""
    array = tomlkit.array().multiline(True)
    for mode in modes:
        inline = tomlkit.inline_table()
        inline.update(mode)
        array.append(inline)
    return array
