"""Writes model/scene/scene.schema.json: the scene file's JSON Schema, by which editors complete and check scenes.

It follows from the classes in model/scene/, and from the descriptions in scene_keys.toml. It is a little more permissive than flexfmu: what
several keys must fulfil together, flexfmu alone checks.

    python generators/scene_schema.py
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from flexfmu.cosim.design.effects.runs import MARGINS
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, definition
from flexfmu.model.scene.loop import ObjectSection
from flexfmu.model.scene.schema import Scene

HERE = Path(__file__).parent
TARGET = HERE.parent / "model" / "scene" / "scene.schema.json"
DRAFT = "http://json-schema.org/draft-07/schema#"
"""The draft that editors for TOML know."""

TABLES = ("joint_friction",)
"""Tables whose `kind` can't stand for them as a word."""

VECTORS = ("start", "lift", "gravity", "band", "corners", "points", "payload_band")
"""Pairs that aren't one value for each joint, and can't be given as one number."""

WORDS = {"modes": ["along-path"], "step": ["auto"], "references": ["rigid", "flexible"]}
"""Key → words that may stand in place of its value."""


def sections(annotation: Any) -> dict[str, type[BaseModel]]:
    """All sections below an annotation, by the name of their class."""
    if annotation is ObjectSection:  # which files can't have
        return {}
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        inside = [sections(field.annotation) for field in annotation.model_fields.values()]
        return {annotation.__name__: annotation} | {name: each for found in inside for name, each in found.items()}
    return {name: each for part in get_args(annotation) for name, each in sections(part).items()}


def description(section: type[BaseModel], key: str, texts: dict[str, dict[str, str]]) -> str:
    """The sentence for a key, from the section or the class that it inherits the key from.

    Raises:
        KeyError: there is none.
    """
    for base in section.__mro__:
        if key in texts.get(base.__name__, {}):
            return texts[base.__name__][key]
    raise KeyError(f"{section.__name__}.{key} has no line in {HERE.name}/scene_keys.toml")


def schema() -> dict[str, Any]:
    """The JSON Schema of the scene file."""
    texts = tomllib.loads((HERE / "scene_keys.toml").read_text(encoding="utf-8"))
    whole = Scene.model_json_schema(ref_template="#/definitions/{model}")
    definitions = whole.pop("$defs")
    for name, section in sections(Scene).items():
        table = whole if section is Scene else definitions[name]
        table.pop("title", None)
        for key in table["properties"]:
            field = _as_in_toml(table["properties"][key], key)
            table["properties"][key] = {"description": description(section, key, texts), **field}
    # the metrics and margins that may be asked for, by name
    accuracy = whole["properties"]["accuracy"]
    either, accuracy["additionalProperties"] = accuracy["additionalProperties"], False
    accuracy["properties"] = {
        name: {"description": f"{each.description} [{each.unit}]", **either}
        for name, each in ((name, definition(name)) for name in (*ALL_METRICS, *MARGINS))
    }
    for name in ("Effects", "ChoiceSection"):
        definitions[name]["properties"]["of"]["items"]["enum"] = [*accuracy["properties"]]
    _allow_shorthands(whole, definitions)
    return {"$schema": DRAFT, "title": "Scene of flexfmu", **whole, "definitions": definitions}


def _as_in_toml(field: Any, key: str) -> Any:
    """A key's schema in draft 7, without null, which TOML doesn't have, and with one number for both joints."""
    field = {name: value for name, value in field.items() if name not in ("title", "discriminator")}
    for union in ("anyOf", "oneOf"):
        options = [_as_in_toml(each, key) for each in field.pop(union, ()) if each != {"type": "null"}]
        if len(options) == 1:
            field |= options[0]
        elif options:
            field["anyOf"] = options
    if field.get("default", 0) is None:
        del field["default"]
    if isinstance(field.get("items"), dict):
        field["items"] = _as_in_toml(field["items"], key)
    if "prefixItems" in field:
        item = field["items"] = _as_in_toml(field.pop("prefixItems")[0], key)
        if key not in VECTORS:
            pair = {name: field.pop(name) for name in ("type", "items", "minItems", "maxItems")}
            field["anyOf"] = [item, pair]
    return field


def _allow_shorthands(whole: dict[str, Any], definitions: dict[str, Any]) -> None:
    """What may be written shorter than the classes say: kinds as words, keys that a choice of effects fills in."""
    for table in definitions.values():
        for key, field in table["properties"].items():
            words = WORDS[key] if key in WORDS else _kinds(field, definitions) if key not in TABLES else []
            if words:
                options = field.pop("anyOf", None) or [
                    {name: field.pop(name) for name in tuple(field) if name not in ("description", "default", "unit")}
                ]
                field["anyOf"] = [{"enum": words}, *options]
    # `select = "auto"` fills in two keys
    chosen = {"properties": {"select": {"const": "auto"}}, "required": ["select"]}
    definitions["Effects"]["required"].remove("basis")
    definitions["Effects"]["anyOf"] = [chosen, {"required": ["basis"]}]
    definitions["Cosimulation"]["required"].remove("tolerance")
    given = {"cosimulation": {"required": ["tolerance"]}}
    whole["anyOf"] = [{"properties": {"effects": chosen}}, {"properties": given}]
    if "motor" in whole["properties"]:
        motor = whole["properties"]["motor"]
        one = {"$ref": motor.pop("$ref")}
        motor["anyOf"] = [one, {"type": "array", "items": one, "minItems": 1, "maxItems": 2}]


def _kinds(field: Any, definitions: dict[str, Any]) -> list[str]:
    """Kinds of a table that need no other key, so that the word alone may stand for the table."""
    options = field.get("anyOf", [field])
    if not all("$ref" in each for each in options):
        return []
    tables = [definitions[each["$ref"].rpartition("/")[2]] for each in options]
    words = []
    for table in tables:
        kind = table["properties"].get("kind", {})
        if kind and set(table.get("required", ())) <= {"kind"}:
            words += kind.get("enum", [kind["const"]] if "const" in kind else [])
    return words


def main() -> None:
    """Write the file."""
    TARGET.write_text(json.dumps(schema(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
