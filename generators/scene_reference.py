"""The page that lists every key of the scene file, from its JSON Schema."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

HEAD = """# Every key of the scene file

Written from the scene file's schema. Units are SI, angles in rad. *Needed* are keys without a default. `→` leads to a table's own keys;
where a table has a `kind`, that decides its other keys. Unknown keys are errors.

Your editor completes keys and shows these sentences: `flexfmu schema -o scene.schema.json` writes the schema, and a scene file
beside it begins with the line `#:schema ./scene.schema.json` (taplo, Even Better TOML).
"""


def page(schema: dict[str, Any]) -> str:
    """The page in Markdown."""
    definitions = schema["definitions"]
    places: dict[str, str] = {}
    lines = [HEAD, "## The file {#scene}", "", *_table(schema, definitions)]
    # each table after the one that first names it
    for key, name in _walk("", schema, definitions, places):
        table = definitions[name]
        kinds = table["properties"].get("kind", {})
        kind = kinds.get("const") or " | ".join(kinds.get("enum", ()))
        heading = f"`{key}`" + (f", kind `{kind}`" if kind and len(kind) < 30 else "")
        lines += [
            "",
            f"{'##' if '.' not in key else '###'} {heading} {{#{name.lower()}}}",
            "",
            table.get("description", ""),
            "",
        ]
        lines += _table(table, definitions)
    return "\n".join(lines) + "\n"


def _walk(
    place: str, table: dict[str, Any], definitions: dict[str, Any], places: dict[str, str]
) -> Iterator[tuple[str, str]]:
    """Dotted key and name of every table below one, each once."""
    for key, field in table["properties"].items():
        for name in _tables(field):
            if name not in places:
                places[name] = f"{place}{key}"
                yield places[name], name
                yield from _walk(f"{place}{key}.", definitions[name], definitions, places)


def _tables(field: dict[str, Any]) -> list[str]:
    """Names of the tables that a key may have."""
    if "$ref" in field:
        return [field["$ref"].rpartition("/")[2]]
    inside = [*field.get("anyOf", ()), *([field["items"]] if "items" in field else ())]
    return list(dict.fromkeys(name for each in inside for name in _tables(each)))


def _table(section: dict[str, Any], definitions: dict[str, Any]) -> list[str]:
    """The keys of a table, a row each."""
    rows = ["| Key | Value | Unit | Default | Meaning |", "|---|---|---|---|---|"]
    needed = section.get("required", ())
    for key, field in section["properties"].items():
        default = "*needed*" if key in needed else _default(field.get("default"))
        names = _tables(field)
        links = ", ".join(f"[→ {_label(name, definitions)}](#{name.lower()})" for name in names)
        value = "; ".join(filter(None, (_value(field), links)))
        cells = (f"`{key}`", value, _find(field, "unit"), default, field["description"])
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return rows


def _label(name: str, definitions: dict[str, Any]) -> str:
    """What a link to a table reads: its kind, or just that it is one."""
    return definitions[name]["properties"].get("kind", {}).get("const", "keys")


def _default(value: Any) -> str:
    """A default as it would stand in the file."""
    if value is None or value == {} or value == []:
        return ""
    if isinstance(value, dict):
        return f"`{value['kind']}`" if "kind" in value else ""
    return f"`{str(value).lower() if isinstance(value, bool) else value!r}`".replace("'", '"')


def _find(field: dict[str, Any], key: str) -> str:
    """A keyword of the schema, also from within alternatives and arrays."""
    inside = [*field.get("anyOf", ()), *([field["items"]] if "items" in field else ())]
    found = field.get(key) or next(filter(None, (_find(each, key) for each in inside)), "")
    return "" if found == "1" else str(found)


def _value(field: dict[str, Any]) -> str:
    """Type and range of a value in words."""
    if "anyOf" in field:
        return " or ".join(dict.fromkeys(filter(None, map(_value, field["anyOf"]))))
    if "const" in field or "enum" in field:
        return " \\| ".join(f"`{word}`" for word in field.get("enum", [field.get("const")])).replace("\\|", "|")
    if field.get("type") == "array":
        many = "two" if field.get("maxItems") == 2 else "list"
        inside = _value(field["items"])
        return f"{many}: {inside}" if inside else "list"
    kinds = {
        "number": "number",
        "integer": "whole number",
        "string": "text",
        "boolean": "true or false",
        "object": "table",
    }
    limits = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    ranges = ", ".join(f"{sign} {field[name]:g}" for name, sign in limits.items() if name in field)
    return f"{kinds.get(field.get('type', ''), '')} {ranges}".strip()
