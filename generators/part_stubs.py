"""Writes src/flexfmu/*.pyi: what type checkers and editors know of names that are made or imported at their first use.

The functions that describe parts of a scene are made of the scene file's sections (`flexfmu.parts`), whose JSON Schema gives the types.

    python generators/part_stubs.py
"""

from __future__ import annotations

import inspect
from importlib import import_module
from pathlib import Path
from types import ModuleType

import flexfmu

FOLDER = Path(__file__).parents[1] / "src" / "flexfmu"


def front() -> str:
    """The text of the stub of `flexfmu` itself, which imports names at their first use."""
    imports = [f"from flexfmu import {family} as {family}" for family in flexfmu._FAMILIES]
    imports += [f"from flexfmu.{home} import {name} as {name}" for name, home in flexfmu._HOMES.items()]
    return "\n".join([*sorted(imports), "", f"__all__ = {flexfmu.__all__!r}", "", "__version__: str", ""])


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
    families = {FOLDER / f"{name}.pyi": stub(import_module(f"flexfmu.{name}")) for name in flexfmu._FAMILIES}
    return {FOLDER / "__init__.pyi": front(), **families}


def main() -> None:
    """Write the files."""
    for path, text in stubs().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
