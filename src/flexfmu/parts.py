"""Makes the functions of `flexfmu.control`, `flexfmu.shapers` and the like from the sections of the scene file.

A part of the loop is described once, by its section: `flexfmu.control.pd(...)` returns what the table ``[[controller]]`` with
``kind = "pd"`` becomes. Names, units, defaults and limits are those of the scene file, whose JSON Schema gives the docstrings.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from os import PathLike, fspath
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from pydantic import ValidationError

import flexfmu.model.scene.schema
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.messages import sentences
from flexfmu.model.scene.section import Section

S = TypeVar("S", bound=Section)


def family(
    module: str, sections: Mapping[str, type[Section]], homes: Mapping[str, str]
) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """The ``__all__``, ``__getattr__`` and ``__dir__`` (PEP 562) of a module with parts of the loop.

    Args:
        module: name of the module.
        sections: call of a function after the module's name, an example → section of the scene file that it describes.
        homes: module → names, with spaces between them, that are imported from there at their first use.
    """
    examples = {example.partition("(")[0]: example for example in sections}
    places = {name: home for home, names in homes.items() for name in names.split()}
    names = sorted(examples | places)

    @cache
    def __getattr__(name: str) -> Any:  # noqa: N807 - it becomes the module's
        if name in examples:
            return part(sections[examples[name]], module, examples[name])
        if name in places:
            return getattr(import_module(f"flexfmu.{places[name]}"), name)
        raise AttributeError(f"module {module!r} has no attribute {name!r}; it has {', '.join(names)}")

    return names, __getattr__, lambda: names


def part(section: type[S], module: str, example: str) -> Callable[..., S]:
    """The function that describes a part of the loop; its arguments are the section's keys.

    Where the section has several kinds the function's name is that of one, ``two_hump_ei`` of ``2-hump-ei``.
    """
    name, place = example.partition("(")[0], f"{module}.{example.partition('(')[0]}"
    kinds = get_args(section.model_fields["kind"].annotation)
    chosen = kinds[0]
    if len(kinds) > 1:
        chosen = name.replace("_", "-").replace("two", "2").replace("three", "3")
    table = definition(section)
    keys = {key: field for key, field in table["properties"].items() if key != "kind"}

    def make(**given: Any) -> S:
        try:
            if "kind" in given:
                raise SceneError(f"the function's name is the kind, got kind={given['kind']!r} ({place})")
            # None leaves a key out
            values = {key: _plain(value) for key, value in given.items() if value is not None}
            return section.model_validate({"kind": chosen, **values})
        except ValidationError as error:
            raise SceneError(f"{'; '.join(sentences(error.errors(), section))} ({place})") from None

    make.__name__ = make.__qualname__ = name
    make.__module__ = module
    make.__doc__ = "\n".join(
        [
            f"{inspect.getdoc(section)}\n\nExample:\n    ``{module}.{example}``\n\nArgs:",
            *(f"    {key}: {_described(field)}" for key, field in keys.items()),
            "\nRaises:\n    SceneError: a value is missing, unknown or out of range.",
        ]
    )
    arguments = [_argument(key, field, key in table.get("required", ())) for key, field in keys.items()]
    make.__annotations__ = {each.name: each.annotation for each in arguments} | {"return": section}
    make.__signature__ = inspect.Signature(arguments, return_annotation=section)  # type: ignore[attr-defined]
    return make


def _argument(key: str, field: Mapping[str, Any], required: bool) -> inspect.Parameter:
    """The argument for a key; None leaves it out."""
    default = inspect.Parameter.empty if required else field.get("default")
    kind = type_of(field) if default is not None else f"{type_of(field)} | None"
    return inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)


@cache
def _definitions() -> dict[str, Any]:
    """The sections of the scene file, by the names of their classes, as JSON Schema."""
    folder = Path(flexfmu.model.scene.schema.__file__).parent
    found: dict[str, Any] = json.loads((folder / "scene.schema.json").read_text(encoding="utf-8"))["definitions"]
    return found


def definition(section: type[Section]) -> dict[str, Any]:
    """The JSON Schema of a section: ``properties``, each with ``description`` and ``unit``, and ``required`` keys."""
    found: dict[str, Any] = _definitions()[section.__name__]
    return found


def type_of(field: Mapping[str, Any]) -> str:
    """The type of a key's values as Python writes it, from its JSON Schema."""
    if "anyOf" in field:
        return " | ".join(dict.fromkeys(type_of(each) for each in field["anyOf"]))
    if "const" in field or "enum" in field:
        return f"Literal[{', '.join(repr(each) for each in field.get('enum', [field.get('const')]))}]"
    if field.get("type") == "array":
        return f"Sequence[{type_of(field['items'])}]" if "items" in field else "Sequence[Any]"
    return {"number": "float", "integer": "int", "string": "str", "boolean": "bool"}.get(
        field.get("type", ""), "Mapping[str, Any]" if "$ref" in field or field.get("type") == "object" else "Any"
    )


def _described(field: Mapping[str, Any]) -> str:
    """What a key is for, with its unit."""
    unit = field.get("unit", "1")
    return f"{field['description']}{'' if unit == '1' else f' In {unit}.'}"


def _plain(value: Any) -> Any:
    """A value as a scene file has it: numpy's arrays and numbers become Python's."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, PathLike):
        return fspath(value)
    return type(value)(map(_plain, value)) if type(value) in (list, tuple) else value
