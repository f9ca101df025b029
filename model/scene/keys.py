"""Dotted keys of a scene: ``payload.mass``, ``trajectory.start[0]``, ``controller[0].derivative``, ``controller.pd.derivative``, or in
short ``pd.kd``."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from flexfmu.model.scene.errors import SceneError

_INDEX = re.compile(r"\[(\d+)\]")

SECTIONS = ("controller", "shaper", "imperfection", "filter", "disturbance", "motor", "plan", "accuracy")
"""Sections that a scene may lack: their names never stand for a slave."""

_KEY_LINE = re.compile(r"""^[ \t]*(?:\[\[?[A-Za-z_]|[\w."'-]+[ \t]*=)""", re.MULTILINE)
"""How a line with a section or a key begins."""

GAINS = {"kp": "proportional", "ki": "integral", "kd": "derivative"}
"""Short name of a gain → its key."""


FREE = ("arguments", "parameters", "connect")
"""Keys whose tables have names of their own."""


def parse_setting(text: str) -> tuple[str, Any]:
    """The key and its value from ``KEY=VALUE``; errors as for `parse_value`."""
    key, sign, value = (part.strip() for part in text.partition("="))
    if not (key and sign and value):
        raise SceneError(f"{text!r} isn't KEY=VALUE: write payload.mass=3.0 or trajectory.profile.kind=poly5")
    return key, parse_value(value, key)


DEEPEST, MOST_KEYS = 50, 5000
"""Largest number of tables and arrays within each other, and of keys at one depth: scenes have six, and some hundred."""


def parse_toml(text: str) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        SceneError: it is none, has a number of thousands of digits, is nested deeper than `DEEPEST`, or has more keys than `MOST_KEYS`; without the file's name.
    """
    # counted before and after: to read 100,000 keys takes most of a second
    keys = sum(1 for _ in _KEY_LINE.finditer(text))
    try:
        data = {} if keys > MOST_KEYS else tomllib.loads(text)
        level: list[Any] = [data]
        for _ in range(DEEPEST):
            tables = [
                each.values() if isinstance(each, dict) else each for each in level if isinstance(each, dict | list)
            ]
            keys = max(keys, sum(len(each) for each in level if isinstance(each, dict)))
            level = [value for values in tables for value in values]
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"not a TOML file: {error}") from error
    except ValueError:  # of Python's conversion
        raise SceneError("not a TOML file: a number has thousands of digits; write it as 1e3") from None
    except RecursionError:
        level = [text]
    if keys > MOST_KEYS:
        raise SceneError(f"not a scene: it has {keys} keys and sections, and at most {MOST_KEYS} are read")
    if level:
        raise SceneError(f"not a scene: arrays or tables are nested deeper than {DEEPEST} levels")
    return data


def parse_value(text: str, key: str) -> Any:
    """A value as TOML has it (number, true, false, array, table, text), or a text without quotes.

    Raises:
        SceneError: it is neither; the message names the key.
    """
    try:
        return parse_toml(f"value = {text}")["value"]
    except SceneError:
        pass
    # numbers that TOML writes otherwise: 01, .5, 1.
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            pass
    if any(sign in text for sign in "\"'[]{}\n"):
        raise SceneError(f"`{key}` has the value {text!r}, which isn't TOML: quote texts, write arrays as [1.0, 2.0]")
    return text


def split_values(text: str, key: str) -> list[str]:
    """The parts between commas outside quotes, brackets and braces.

    Raises:
        SceneError: a part is empty, or something isn't closed.
    """
    parts, depth, quote = [""], 0, ""
    for sign in text:
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "\"'":
            quote = sign
        else:
            depth += (sign in "[{") - (sign in "]}")
        if sign == "," and not depth and not quote:
            parts.append("")
        else:
            parts[-1] += sign
    if quote or depth or not all(each.strip() for each in parts):
        raise SceneError(f"`{key}` has an empty or unfinished value in {text!r}: write VALUE,VALUE")
    return [each.strip() for each in parts]


def set_value(data: dict[str, Any], key: str, value: Any, label: str) -> None:
    """Set the value of a dotted key in a scene's plain data; sections that are missing are added.

    Args:
        data: the scene as nested dicts; arrays may be tuples.
        key: names of sections and key, separated by dots. An index in brackets is an element of an array; a table of an
            array of tables may also be named by its ``name`` or, where that is unique, its ``kind``, also without the
            array's name: ``pd.proportional``, or ``pd.kp``.
        value: the new value.
        label: name of the scene in messages.

    Raises:
        SceneError: a part of the key is a value without keys, or an array has no such element.
    """
    *parents, last = _parts(data, key, label)
    section: Any = data
    for i, part in enumerate(parents):
        place = _place(section, part, parents[:i], key, label)
        inside = section.get(place, {}) if isinstance(section, dict) else section[place]
        # plain containers are copied: they may be the caller's, and arrays may be tuples
        if type(inside) in (dict, list, tuple):
            inside = dict(inside) if isinstance(inside, dict) else list(inside)
        section[place] = inside
        section = inside
    section[_place(section, last, parents, key, label)] = value


def value_at(data: Mapping[str, Any], key: str, label: str = "") -> Any:
    """The value of a dotted key in a scene's plain data, None where it isn't set; arguments and errors as for `set_value`."""
    return [found for _, found in _walk(data, key, label)][-1]


def location(data: Mapping[str, Any], key: str) -> tuple[str | int, ...]:
    """The key as pydantic writes locations of errors: names, indices, and kinds of tables that have one."""
    where: list[str | int] = []
    for place, found in _walk(data, key, "the scene"):
        where.append(place)
        if isinstance(found, Mapping) and "kind" in found:
            where.append(found["kind"])
    return tuple(where)


def _walk(data: Mapping[str, Any], key: str, label: str) -> Iterator[tuple[Any, Any]]:
    """Place and value of each part of a dotted key, None where it isn't set; errors as for `set_value`."""
    found: Any = data
    parts = _parts(data, key, label)
    for i, part in enumerate(parts):
        place = _place(found, part, parts[:i], key, label)
        if found is not None:
            found = found.get(place) if isinstance(found, Mapping) else found[place]
        yield place, found


def full_key(data: Mapping[str, Any], key: str, label: str = "the scene") -> str:
    """The key that starts with the name of a section: ``controller[0].proportional`` for ``pd.kp``; errors as for `set_value`."""
    parts = _parts(data, key, label)
    if len(parts) > 1 and isinstance(tables := data.get(str(parts[0])), list | tuple):
        parts[1] = _place(tables, parts[1], parts[:1], key, label)
    return _written(parts)


def _parts(data: Mapping[str, Any], key: str, label: str) -> list[str | int]:
    """Names and indices of a dotted key; a slave's name or kind in place of a section is replaced by array and index.

    Raises:
        SceneError: several slaves are of this kind.
    """
    parts: list[str | int] = []
    for name in key.split("."):
        parts.append(_INDEX.sub("", name))
        parts += [int(index) for index in _INDEX.findall(name)]
    # a slave in place of a section
    head = parts[0]
    if head not in data and head not in SECTIONS:
        homes = _slaves(data, str(head))
        if len(homes) > 1:
            places = ", ".join(_written(home) for home in homes)
            raise SceneError(
                f"{label} has no key {key}: {head} may be {places}; write one of these, or give each a `name`"
            )
        parts[:1] = homes[0] if homes else parts[:1]
    # a gain by its short name
    if len(parts) > 2 and isinstance(data.get(str(parts[0])), list | tuple) and parts[2] not in FREE:
        parts[2:] = [GAINS.get(str(part), part) for part in parts[2:]]
    return parts


def _slaves(data: Mapping[str, Any], word: str) -> list[list[str | int]]:
    """Array and index of the tables that have this ``name``; if none has, of those of this ``kind``."""
    arrays = {name: each for name, each in data.items() if isinstance(each, list | tuple)}
    for field in ("name", "kind"):
        found: list[list[str | int]] = [
            [array, i]
            for array, tables in arrays.items()
            for i, each in enumerate(tables)
            if isinstance(each, Mapping) and each.get(field) == word
        ]
        if found:
            return found
    return []


def _place(holder: Any, part: str | int, before: Sequence[str | int], key: str, label: str) -> Any:
    """Where a part of a key is in the table or array that holds it: its name or its index.

    Raises:
        SceneError: it holds no such part.
    """
    if holder is None or (isinstance(holder, Mapping) and isinstance(part, str)):
        return part
    path = _written(before)
    # an array, or what isn't there
    if isinstance(holder, list | tuple) or holder == {}:
        if isinstance(part, str) and part.isdigit():
            part = int(part)
        if isinstance(part, int) and part < len(holder):
            return part
        # a table by its name, or else by its kind
        for field in ("name", "kind"):
            found = [i for i, each in enumerate(holder) if isinstance(each, Mapping) and each.get(field) == part]
            if len(found) == 1:
                return found[0]
        raise SceneError(f"{label} has no key {key}: {path} has {_elements(holder)}")
    raise SceneError(f"{label} has no key {key}: {path} is the value {holder!r}, not a section")


def _elements(holder: Sequence[Any]) -> str:
    """What an array has, for a message."""
    names = [str(each.get("name") or each.get("kind")) for each in holder if isinstance(each, Mapping)]
    if not holder:
        return "no elements"
    count = "one element, [0]" if len(holder) == 1 else f"{len(holder)} elements, [0] to [{len(holder) - 1}]"
    return count + (f", named {', '.join(names)}" if names else "")


def _written(parts: Sequence[str | int]) -> str:
    """Parts of a key as they are written."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).removeprefix(".")
