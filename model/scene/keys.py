"""Dotted keys of a scene: ``payload.mass``, ``trajectory.start[0]``, ``controller[0].derivative`` or ``controller.pd.derivative``."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from flexfmu.model.scene.errors import SceneError

_INDEX = re.compile(r"\[(\d+)\]")


def parse_setting(text: str) -> tuple[str, Any]:
    """The key and its value from ``KEY=VALUE``; errors as for `parse_value`."""
    key, sign, value = (part.strip() for part in text.partition("="))
    if not (key and sign and value):
        raise SceneError(f"{text!r} isn't KEY=VALUE: write payload.mass=3.0 or trajectory.profile.kind=poly5")
    return key, parse_value(value, key)


def parse_value(text: str, key: str) -> Any:
    """A value as TOML has it (number, true, false, array, table, text), or a text without quotes.

    Raises:
        SceneError: it is neither; the message names the key.
    """
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
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


def set_value(data: dict[str, Any], key: str, value: Any, label: str) -> None:
    """Set the value of a dotted key in a scene's plain data; sections that are missing are added.

    Args:
        data: the scene as nested dicts; arrays may be tuples.
        key: names of sections and key, separated by dots. An index in brackets is an element of an array; a table of an
            array of tables may also be named by its ``name`` or, where that is unique, its ``kind``.
        value: the new value.
        label: name of the scene in messages.

    Raises:
        SceneError: a part of the key is a value without keys, or an array has no such element.
    """
    *parents, last = _parts(key)
    section: Any = data
    for i, part in enumerate(parents):
        place = _place(section, part, parents[:i], key, label)
        inside = section.get(place, {}) if isinstance(section, dict) else section[place]
        # an array that can be changed
        section[place] = inside = list(inside) if isinstance(inside, tuple) else inside
        section = inside
    section[_place(section, last, parents, key, label)] = value


def value_at(data: Mapping[str, Any], key: str, label: str = "") -> Any:
    """The value of a dotted key in a scene's plain data, None where it isn't set; arguments and errors as for `set_value`."""
    found: Any = data
    parts = _parts(key)
    for i, part in enumerate(parts):
        place = _place(found, part, parts[:i], key, label)
        found = found.get(place) if isinstance(found, Mapping) else found[place]
        if found is None:
            return None
    return found


def location(data: Mapping[str, Any], key: str) -> tuple[str | int, ...]:
    """The key as pydantic writes locations of errors: names, indices, and kinds of tables that have one."""
    found: Any = data
    parts = _parts(key)
    where: list[str | int] = []
    for i, part in enumerate(parts):
        place = _place(found, part, parts[:i], key, "")
        where.append(place)
        found = (found.get(place) if isinstance(found, Mapping) else found[place]) if found is not None else None
        if isinstance(found, Mapping) and "kind" in found:
            where.append(found["kind"])
    return tuple(where)


def _parts(key: str) -> list[str | int]:
    """Names and indices of a dotted key."""
    parts: list[str | int] = []
    for name in key.split("."):
        parts.append(_INDEX.sub("", name))
        parts += [int(index) for index in _INDEX.findall(name)]
    return parts


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
    return f"{len(holder)} elements, [0] to [{len(holder) - 1}]" + (f", named {', '.join(names)}" if names else "")


def _written(parts: Sequence[str | int]) -> str:
    """Parts of a key as they are written."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).removeprefix(".")
