"""The documentation: its Python needs `import flexfmu` alone, its reference has every public name, and its pages need nothing from
elsewhere."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

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


SEARCHED = {
    "install": "install.html",
    "first frequency": "how-to.html",
    "natural frequency": "how-to.html",
    "Bode": "margins.html",
    "peak torque": "how-to.html",
    "encoder": "control-loop.html",
    "python-control": "reference/python.html",
    "MATLAB": "how-to.html",
}
"""What people look for → a page among the first seven that the search shows."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built without a warning, unless FLEXFMU_TEST_SITE names the folder of `make docs`, which does the same."""
    if built := os.environ.get("FLEXFMU_TEST_SITE"):
        return Path(built)
    pytest.importorskip("material", reason="needs mkdocs-material")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder)]
    outcome = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=600)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    return folder


@pytest.mark.slow
def test_site_is_whole_and_offline(site: Path) -> None:
    """Its pages load nothing from elsewhere."""
    pages = list(site.rglob("*.html"))
    assert len(pages) >= len(list(DOCS.rglob("*.md")))
    loaded = r"<(?:script|img|link|iframe)[^>]*(?:src|href)=[\"']?(?:https?:)?//[^>]*>"
    assert [page.name for page in pages if re.search(loaded, page.read_text(encoding="utf-8"))] == []


@pytest.mark.slow
def test_search_finds_what_people_look_for(browser: Any, site: Path) -> None:
    """Typed into the search of the site in Chromium, opened from its file, without a network."""
    page = browser.new_page()
    page.goto((site / "index.html").as_uri())
    page.keyboard.press("/")
    page.locator("[data-md-component=search-query]:focus").wait_for(timeout=60_000)
    for query, wanted in SEARCHED.items():
        # none is left of the query before
        page.keyboard.press("Control+A")
        page.keyboard.press("Backspace")
        page.locator(".md-search-result__link").first.wait_for(state="detached", timeout=60_000)
        # each key starts a search
        page.keyboard.insert_text(query[:-1])
        page.keyboard.type(query[-1])
        page.locator(".md-search-result__link").first.wait_for(state="attached", timeout=60_000)
        links = page.locator(".md-search-result__link").evaluate_all("found => found.map(each => each.href)")
        shown = list(dict.fromkeys(re.sub(r"[?#].*", "", link).removeprefix(f"{site.as_uri()}/") for link in links))
        assert wanted in shown[:7], (query, shown)
    page.close()
