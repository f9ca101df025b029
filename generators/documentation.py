"""What the documentation's site gets beside the pages in docs/: hooks of MkDocs, see mkdocs.yml.

The reference of the scene file is written from its JSON Schema, and each tutorial becomes a notebook too.
The packages are linked into one folder, as an installation has them, where mkdocstrings reads their docstrings. Links of pages
to files outside docs/ lead to copies of these in the site.
"""

from __future__ import annotations

import json
import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
PACKAGES = ROOT / "build" / "docs" / "flexfmu"
OUTSIDE = re.compile(r"\]\((?:\.\./)+((?:examples|benchmarks|model)/[^)#]+|[A-Z]+\.md)\)")
"""A link to a file outside docs/; its path in the repository."""


sys.path.insert(0, str(ROOT / "generators"))
import notebooks  # noqa: E402  # the folder of a hook isn't on the path
import scene_reference  # noqa: E402


def on_startup(**_: Any) -> None:
    """Link the packages below one folder, before mkdocstrings looks whether it exists."""
    PACKAGES.mkdir(parents=True, exist_ok=True)
    tops = (ROOT / name for name in ("model", "fmu_build", "trajectories", "cosim"))
    targets = {path.name: path for path in (*(ROOT / "src" / "flexfmu").glob("*.py"), *tops)}
    for link in PACKAGES.iterdir():
        if link.name not in targets:
            link.unlink(missing_ok=True)
    # another build may read them at the same time
    for name, path in targets.items():
        with suppress(FileExistsError):
            (PACKAGES / name).symlink_to(path)


def on_files(files: Files, config: Any) -> Files:
    """Add the files outside docs/ that pages have links to."""
    pages = [Path(file.abs_src_path).read_text(encoding="utf-8") for file in files.documentation_pages()]
    for path in sorted({path for text in pages for path in OUTSIDE.findall(text)}):
        # as text, which browsers show
        files.append(File.generated(config, f"files/{path}.txt", content=(ROOT / path).read_bytes()))
    schema = json.loads((ROOT / "model" / "scene" / "scene.schema.json").read_text(encoding="utf-8"))
    page = File.generated(config, "reference/scene.md", content=scene_reference.page(schema))
    files.append(page)
    for path in sorted((ROOT / "docs" / "tutorials").glob("*.md")):
        notebook = json.dumps(notebooks.notebook(path.read_text(encoding="utf-8")), indent=1)
        files.append(File.generated(config, f"tutorials/{path.stem}.ipynb", content=notebook))
    # the search of pages on the disk, in place of a script that the theme would load from elsewhere
    config.extra["polyfills"] = ["assets/search_worker.js"]
    worker = (ROOT / "generators" / "search_worker.js").read_text(encoding="utf-8")
    files.append(File.generated(config, "assets/search_worker.js", content=worker))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links to files outside docs/ lead to their copies, and one of each tutorial to its notebook."""
    folder, _, name = page.file.src_uri.rpartition("/")
    if folder == "tutorials":
        title, _, rest = markdown.partition("\n")
        markdown = f"{title}\n\n[This page as a notebook]({name.replace('.md', '.ipynb')})\n{rest}"
    up = "../" * page.file.src_uri.count("/")
    return OUTSIDE.sub(rf"]({up}files/\1.txt)", markdown)
