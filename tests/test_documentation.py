"""The documentation: its Python needs `import flexfmu` alone, its reference has every public name, and its pages need nothing from
elsewhere."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import flexfmu

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
REFERENCE = (DOCS / "reference" / "python.md").read_text(encoding="utf-8")
LISTED = re.findall(r"^::: (\S+)", REFERENCE, re.MULTILINE)


def found(name: str) -> object:
    """What a dotted name stands for."""
    module, _, member = name.rpartition(".")
    return getattr(import_module(module), member)


def python() -> list[tuple[str, str]]:
    """The documented Python: each example, and each block of README, pages and tutorials, with the name of its file.

    `docs/adding-parts.md` is left out: it shows parts of flexfmu itself.
    """
    pages = [path for path in (ROOT / "README.md", *DOCS.rglob("*.md")) if path.name != "adding-parts.md"]
    blocks = [
        (page.name, block)
        for page in pages
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    ]
    return blocks + [(path.name, path.read_text(encoding="utf-8")) for path in (ROOT / "examples").glob("*.py")]


def imported(tree: ast.AST) -> Iterator[str]:
    """The modules of flexfmu that a text imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names if each.name.startswith("flexfmu"))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("flexfmu"):
            yield from (f"{node.module}.{each.name}" for each in node.names)


def chain(node: ast.expr) -> list[str]:
    """The names of an expression a.b.c; empty for any other expression."""
    if isinstance(node, ast.Name):
        return [node.id]
    if isinstance(node, ast.Attribute) and (before := chain(node.value)):
        return [*before, node.attr]
    return []


def used(tree: ast.AST) -> Iterator[list[str]]:
    """Names that a text takes from flexfmu: [flexfmu, run], [flexfmu, control, pd]."""
    for node in ast.walk(tree):
        names = chain(node) if isinstance(node, ast.Attribute) else []
        if names[:1] == ["flexfmu"]:
            yield names


@pytest.mark.parametrize(
    ("name", "text"), [pytest.param(*each, id=f"{k}-{each[0]}") for k, each in enumerate(python())]
)
def test_documented_python_needs_the_front_door_alone(name: str, text: str) -> None:
    """No import is deeper than `flexfmu.control`, and each name is a public one of flexfmu or of one of its families."""
    tree = ast.parse(text)
    for module in imported(tree):
        assert module == "flexfmu" or module.removeprefix("flexfmu.") in flexfmu.__all__, f"{name} imports {module}"
    for _, first, *rest in used(tree):
        assert first in flexfmu.__all__, f"{name}: flexfmu.{first} is no public name"
        home = getattr(flexfmu, first)
        if isinstance(home, ModuleType) and rest:
            assert rest[0] in home.__all__, f"{name}: flexfmu.{first}.{rest[0]} is no public name"


def test_reference_has_every_public_name() -> None:
    """Each name of `import flexfmu` has its entry; functions that make parts are listed, other names of families have entries too."""
    entries = [found(name) for name in LISTED]
    for name in flexfmu.__all__:
        each = getattr(flexfmu, name)
        if not isinstance(each, ModuleType):
            assert name == "__version__" or any(each is entry for entry in entries), name
            continue
        for inner in each.__all__:
            made = f"`{inner}`" in REFERENCE
            assert made or any(getattr(each, inner) is entry for entry in entries), f"{name}.{inner}"


@pytest.mark.slow
def test_site_is_whole_and_offline(tmp_path: Path) -> None:
    """It builds without a warning, and its pages load nothing from elsewhere."""
    pytest.importorskip("material", reason="needs mkdocs-material")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path)]
    outcome = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=600)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) >= len(list(DOCS.rglob("*.md")))
    loaded = r"<(?:script|img|link|iframe)[^>]*(?:src|href)=[\"']?(?:https?:)?//[^>]*>"
    assert [page.name for page in pages if re.search(loaded, page.read_text(encoding="utf-8"))] == []
