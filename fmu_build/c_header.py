"""Structures and functions of C headers as ctypes has them, so that layouts and signatures stand once, in C."""

from __future__ import annotations

import re
from collections.abc import Mapping
from ctypes import POINTER, Structure, c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any

Signature = tuple[Any, ...]
"""C types of the result and of the arguments; pointers are addresses, but for those to known structures."""

TYPES: Mapping[str, Any] = {"double": c_double, "int": c_int, "size_t": c_size_t, "unsigned": c_uint, "void": None}
"""C types without pointers."""


def structures(text: str) -> dict[str, Any]:
    """Return the structures of a header by name; each may have those before it as members, and no arrays.

    Raises:
        KeyError: a member is of an unknown type.
    """
    found: dict[str, Any] = {}
    for body, name in re.findall(r"typedef struct \{(.*?)\} (\w+);", _bare(text), re.DOTALL):
        types, fields = {**TYPES, **found}, list[tuple[str, Any]]()
        for member in filter(str.strip, body.split(";")):
            # a pointer to a function, or names of one type and of pointers to it
            function, words = re.search(r"\(\*(\w+)\)", member), re.findall(r"\w+", member)
            names = [function[0]] if function else member.split(",")
            kinds = (c_void_p if "*" in each else types[words[0]] for each in names)
            fields += zip((re.findall(r"\w+", each)[-1] for each in names), kinds, strict=True)
        found[name] = type(name, (Structure,), {"_fields_": fields})
    return found


def signatures(
    text: str, types: Mapping[str, Any] = TYPES, known: Mapping[str, Any] | None = None
) -> dict[str, Signature]:
    """Return the signatures of a header's exported functions by name; of FMI's headers, which have types of functions, of all.

    Args:
        text: the header.
        types: types by name; others are handles and callbacks, which are addresses.
        known: structures by name, to which arguments may point.
    """

    def type_of(declaration: str) -> Any:
        word = next(each for each in re.findall(r"\w+", declaration) if each != "const")
        if "*" in declaration or "[" in declaration:
            return POINTER(known[word]) if known and word in known else c_void_p
        return types.get(word, c_void_p)

    pattern = r"(?:typedef|\w*EXPORT\w*)\s+(\w[\w ]*?[\s*]+)(\w+?)(?:TYPE)?\s*\(([^()]*)\)\s*;"
    return {
        name: (type_of(result), *(type_of(each) for each in arguments.split(",") if each.strip() != "void"))
        for result, name, arguments in re.findall(pattern, _bare(text))
    }


def typed(library: Any, text: str, known: Mapping[str, Any]) -> Any:
    """Return a loaded library whose functions have the signatures of a header with these structures."""
    for name, (result, *arguments) in signatures(text, known=known).items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def _bare(text: str) -> str:
    """A header without comments and lines of the preprocessor."""
    return re.sub(r"/\*.*?\*/|^\s*#.*?$", "", text, flags=re.DOTALL | re.MULTILINE)
