"""Examples of arrays for error messages, from the types of the scene file's keys."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel


def array_example(section: type[BaseModel] | None, key: str) -> str:
    """What the array of a section's key may look like: numbers, texts, or arrays of them.

    Args:
        section: that has the key; None where that isn't known.
        key: its name, followed by the indices of an array within it, like ``gain[0]``.
    """
    name, *indices = key.split("[")
    field = section.model_fields.get(name) if section is not None else None
    annotation: Any = field.annotation if field is not None else None
    for _ in indices:
        annotation = _element(annotation)
    return _example(_element(annotation))


def _example(element: Any) -> str:
    """An array of elements of some type."""
    if get_origin(element) is Annotated:
        return _example(get_args(element)[0])
    if get_origin(element) is tuple:
        row = _example(_element(element))
        return f"[{row}, {row}]"
    if get_origin(element) is Literal:
        return _quoted(get_args(element)[:2])
    return _quoted(("a", "b")) if element is str else "[1.0, 2.0]"


def _quoted(texts: tuple[str, ...]) -> str:
    return "[" + ", ".join(f'"{text}"' for text in texts) + "]"


def _element(annotation: Any) -> Any:
    """The type of the elements of the tuple in an annotation; None where there is none."""
    if get_origin(annotation) is tuple:
        return get_args(annotation)[0]
    return next((found for part in get_args(annotation) if (found := _element(part)) is not None), None)
