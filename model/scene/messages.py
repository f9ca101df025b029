"""Error messages for scene files: one sentence with key, value, unit and remedy for each error."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel

from flexfmu.model.scene.keys import GAINS
from flexfmu.model.scene.loop import ObjectSection

MOST_HOMES = 3
"""Largest number of other kinds with a key for which they are named."""


def listed(names: Any) -> str:
    """The names in backquotes, separated by commas."""
    return ", ".join(f"`{name}`" for name in names)


def sentences(errors: Iterable[Mapping[str, Any]], root: type[BaseModel]) -> list[str]:
    """The messages for pydantic's errors in the section ``root``: one for each, but unknown keys with the same remedy have one together."""
    found: dict[str, list[str]] = {}
    for error in errors:
        if error["type"] == "extra_forbidden":
            key, remedy = _unknown(error["loc"], root)
            found.setdefault(remedy, []).append(key)
        else:
            found[_sentence(error, root)] = []
    return [_unknown_sentence(keys, text) if keys else text for text, keys in found.items()]


def _unknown_sentence(keys: list[str], remedy: str) -> str:
    if len(keys) == 1:
        return f"{listed(keys)} is not a known key: {remedy.format(they='it belongs', them='it')}"
    return f"{listed(keys[:-1])} and {listed(keys[-1:])} are not known keys: {remedy.format(they='they belong', them='them')}"


def _unknown(location: tuple[Any, ...], root: type[BaseModel]) -> tuple[str, str]:
    """An unknown key, and what to do about it and others like it."""
    keys, model, _, kinds = _locate(location, root)
    name, known = keys[-1], list(model.model_fields) if model is not None else []
    # a key of another kind, of which a section whose kind was changed has many
    homes = [str(tag) for each in kinds if name in each.model_fields for tag in tags_of(each)]
    if model is not None and 0 < len(homes) <= MOST_HOMES:
        own = tags_of(model)[0]
        remedy = f"{{they}} to kind {' or '.join(map(repr, homes))}, not to {own!r}; remove {{them}}, or set `{'.'.join(keys[:-1])}` as a whole"
        return ".".join(keys), remedy
    close = [GAINS[name]] if GAINS.get(name) in known else difflib.get_close_matches(name, known, n=1)
    return ".".join(keys), f"did you mean `{close[0]}`?" if close else f"known keys here: {listed(known)}"


def _sentence(error: Mapping[str, Any], root: type[BaseModel]) -> str:
    """The message for one of pydantic's errors."""
    keys, model, unit, _ = _locate(error["loc"], root)
    key, annotation = ".".join(keys), _annotation(model, keys)
    kind, context, value = error["type"], error.get("ctx", {}), error["input"]
    unit = "" if unit == "1" else unit.replace(".", "·")  # as people write it
    # a key that is missing
    if kind == "missing":
        words = get_args(annotation) if get_origin(annotation) is Literal else ()
        remedy = f" (in {unit})" if unit else f", one of {', '.join(map(repr, words))}" if words else ""
        return f"`{key}` is missing: add it{remedy}"
    # message of one of the project's validators
    if kind == "value_error":
        return f"{f'in `{key}`: ' if key else ''}{context['error']}"
    # tables and their kinds
    if kind == "tuple_type" and any(sections_in(annotation)):
        remedy = f"instead of [{key}]" if isinstance(value, dict) else f"and the keys below it, got {value!r}"
        return f"`{key}` is a list of tables: write [[{key}]] {remedy}"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        kinds = [tag for each in sections_in(annotation) if each is not ObjectSection for tag in tags_of(each)]
        given = (value if isinstance(value, dict) else vars(value)).get("kind")
        found = "but is missing" if kind == "union_tag_not_found" else f"got {given!r}"
        return f"`{key}.kind` must be one of {', '.join(map(repr, kinds))}, {found}"
    # a value out of range, of the wrong form, or anything else that pydantic finds
    if kind in _BOUNDS:
        unit = f" {unit}" if unit else ""
        return f"`{key}` must be {_BOUNDS[kind].format(**context)}{unit}, got {value!r}{unit}"
    in_unit = f" in {unit}" if unit else ""
    if kind in _FORMS:
        # the elements of the array, or of an array within it
        elements = _annotation(model, keys)
        for _ in range(keys[-1].count("[") + 1 if keys else 0):
            elements = _element(elements)
        form = _FORMS[kind].format(**context, example=_example(elements))
        return f"`{key}` must be {form}{in_unit}, got {list(value) if isinstance(value, tuple) else value!r}"
    found = error["msg"].replace("Input should be", "must be").replace("Field required", "is missing")
    found = found.replace("False, True", "false, true")  # as TOML writes them
    return f"`{key}` {found}{in_unit}, got {value!r}"


_FORMS = {
    "tuple_type": "an array like {example}",
    "bool_type": "true or false",
    "too_long": "an array of {max_length} values",
    "model_type": "a table like {{ key = value }}",
    "model_attributes_type": "a table like {{ key = value }}",
    "dict_type": "a table like {{ key = value }}",
    "string_type": "a text in quotes",
    "string_too_short": "a text that is not empty",
    "string_pattern_mismatch": "made of letters, digits and the characters in the pattern {pattern}",
}
"""Error type of pydantic → expected value."""

_BOUNDS = {
    "greater_than": "above {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "below {lt}",
    "less_than_equal": "at most {le}",
}


def unit_of(location: tuple[str | int, ...], root: type[BaseModel]) -> str:
    """Unit of the key at a location, as pydantic writes it; empty where it has none."""
    keys, model, unit, _ = _locate(location, root)
    unit = unit or next(_units(_annotation(model, keys)), "")
    return "" if unit == "1" else unit


def _units(annotation: Any) -> Iterator[str]:
    """Units within an annotation, as of a quantity that may be left out."""
    for part in getattr(annotation, "__metadata__", ()):
        extra = getattr(part, "json_schema_extra", None)
        if isinstance(extra, dict) and "unit" in extra:
            yield str(extra["unit"])
    for part in get_args(annotation):
        yield from _units(part)


def _annotation(model: type[BaseModel] | None, keys: list[str]) -> Any:
    """Annotation of the last key in its section; None if the section has no such key."""
    field = model.model_fields.get(keys[-1].partition("[")[0]) if model is not None and keys else None
    return None if field is None else field.annotation


def _locate(
    location: tuple[Any, ...], root: type[BaseModel]
) -> tuple[list[str], type[BaseModel] | None, str, list[type[BaseModel]]]:
    """Keys of the scene file, section of the last key, its unit, and sections of the other kinds, for an error location of pydantic."""
    # follow the location: keys so far, possible sections of the next part, section of the last key
    keys: list[str] = []
    variants: list[type[BaseModel]] = [root]
    holder: type[BaseModel] | None = root
    kinds: list[type[BaseModel]] = []
    unit = ""
    for i, part in enumerate(location):
        model = variants[0] if len(variants) == 1 else None
        field = model.model_fields.get(part) if model is not None and isinstance(part, str) else None
        if field is not None:
            keys.append(str(part))
            holder = model
            extra = field.json_schema_extra
            unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
            variants, kinds = list(sections_in(field.annotation)), []
        elif isinstance(part, int):
            keys[-1] += f"[{part}]"
        # the tag of a kind; where it can't be one, the same word is a key
        elif (len(variants) > 1 or i + 1 < len(location)) and (chosen := _variant(variants, part)) is not None:
            variants, holder, kinds = [chosen], chosen, [each for each in variants if each is not chosen]
        else:
            keys.append(str(part))
            holder, variants = model, []
    return keys, holder, unit, kinds


def sections_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """All section types in the annotation of a field."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from sections_in(part)


def _variant(variants: list[type[BaseModel]], tag: Any) -> type[BaseModel] | None:
    """The section whose `kind` may be `tag`; None if there is none."""
    return next((model for model in variants if tag in tags_of(model)), None)


def tags_of(section: type[BaseModel]) -> tuple[Any, ...]:
    """What the `kind` of a section may be; none if it has no kind."""
    kind = section.model_fields.get("kind")
    return () if kind is None else get_args(kind.annotation)


def _example(element: Any) -> str:
    """An example of an array with elements of this type."""
    if get_origin(element) is Annotated:
        return _example(get_args(element)[0])
    if get_origin(element) is tuple:
        row = _example(_element(element))
        return f"[{row}, {row}]"
    texts = get_args(element)[:2] if get_origin(element) is Literal else ("a", "b") if element is str else ()
    return "[" + ", ".join(f'"{text}"' for text in texts) + "]" if texts else "[1.0, 2.0]"


def _element(annotation: Any) -> Any:
    """The element type of the tuple in an annotation; None if there is no tuple."""
    if get_origin(annotation) is tuple:
        return get_args(annotation)[0]
    return next((found for part in get_args(annotation) if (found := _element(part)) is not None), None)
