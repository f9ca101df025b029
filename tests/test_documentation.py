"""The documentation's site: its reference has every public name, and its pages need nothing from elsewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import flexfmu

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
REFERENCE = "\n".join(path.read_text(encoding="utf-8") for path in (DOCS / "reference").glob("*.md"))
LISTED = re.findall(r"^::: (\S+)", REFERENCE, re.MULTILINE)


def found(name: str) -> object:
    """What a dotted name stands for."""
    module, _, member = name.rpartition(".")
    try:
        return getattr(import_module(module), member)
    except AttributeError:
        return import_module(name)


def public() -> list[str]:
    """Names of the front door, and those that README, guides and examples import."""
    texts = [*(ROOT / "examples").glob("*.py"), *DOCS.rglob("*.md"), ROOT / "README.md"]
    text = "\n".join(path.read_text(encoding="utf-8") for path in texts if path.name != "adding-parts.md")
    imports = re.findall(r"^from (flexfmu[\w.]*) import (\([^)]*\)|[^#\n]*)", text, re.MULTILINE)
    names = {f"{module}.{name}" for module, names in imports for name in re.findall(r"[A-Za-z_]\w*", names)}
    return sorted(names | {f"flexfmu.{name}" for name in flexfmu.__all__ if name != "__version__"})


def test_reference_has_every_public_name() -> None:
    """Whatever a user imports by our advice has its entry: itself, or the package whose names are all there."""
    entries = [found(name) for name in LISTED]
    packages = tuple(f"{name}." for name in LISTED)
    missing = [
        name for name in public() if not name.startswith(packages) and not any(found(name) is e for e in entries)
    ]
    assert missing == []


@pytest.mark.slow
def test_site_is_whole_and_offline(tmp_path: Path) -> None:
    """It builds without a warning, and its pages load nothing from elsewhere."""
    pytest.importorskip("material", reason="needs mkdocs-material")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path)]
    outcome = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) >= len(list(DOCS.rglob("*.md")))
    loaded = r"<(?:script|img|link|iframe)[^>]*(?:src|href)=[\"']?(?:https?:)?//[^>]*>"
    assert [page.name for page in pages if re.search(loaded, page.read_text(encoding="utf-8"))] == []
