"""Writes src/flexfmu/control.pyi and its like: what type checkers and editors know of the functions that describe parts of a scene.

The functions are made of the scene file's sections (`flexfmu.parts`), whose JSON Schema gives the types.

    python generators/part_stubs.py
"""

from __future__ import annotations

import inspect
from importlib import import_module
from pathlib import Path
from types import ModuleType

FOLDER = Path(__file__).parents[1] / "src" / "flexfmu"

FAMILIES = ("control", "disturbances", "filters", "imperfections", "shapers")
"""Modules whose functions `flexfmu.parts.part` makes."""


def stub(family: ModuleType) -> str:
    """The text of a module's stub: a signature with types for each part, imports for the other names."""
    lines, imports = [], set[str]()
    for name in family.__all__:
        each = getattr(family, name)
        if each.__module__ != family.__name__:
            imports.add(f"from {each.__module__} import {name} as {name}")
            continue
        signature = inspect.signature(each)
        section = signature.return_annotation
        imports.add(f"from {section.__module__} import {section.__name__}")
        arguments = "".join(
            f"    {key}: {argument.annotation}{'' if argument.default is argument.empty else ' = ...'},\n"
            for key, argument in signature.parameters.items()
        )
        lines.append(f"def {name}(\n    *,\n{arguments}) -> {section.__name__}: ...\n")
    used = "".join(lines)
    imports |= {f"from typing import {word}" for word in ("Any", "Literal") if f"{word}" in used}
    imports |= {f"from collections.abc import {word}" for word in ("Mapping", "Sequence") if f"{word}[" in used}
    return "\n".join([*sorted(imports), "", f"__all__ = {list(family.__all__)!r}", "", used])


def stubs() -> dict[Path, str]:
    """Path of each stub → its text."""
    return {FOLDER / f"{name}.pyi": stub(import_module(f"flexfmu.{name}")) for name in FAMILIES}


def main() -> None:
    """Write the files."""
    for path, text in stubs().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
