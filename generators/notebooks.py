"""Tutorials in Markdown as Jupyter notebooks: each block of Python is a cell, each block of text below one its output."""

from __future__ import annotations

import re
from typing import Any

BLOCK = re.compile(r"^```(python|text)\n(.*?)^```$\n?", re.DOTALL | re.MULTILINE)


def notebook(markdown: str) -> dict[str, Any]:
    """The notebook of a page, format 4.5."""
    cells: list[dict[str, Any]] = []
    # text, language, block, text, language, block, ..., text
    parts = BLOCK.split(markdown)
    for text, language, block in zip(parts[::3], [*parts[1::3], ""], [*parts[2::3], ""], strict=True):
        if text.strip():
            cells.append({"cell_type": "markdown", "source": text.strip()})
        if language == "python":
            cells.append({"cell_type": "code", "source": block.rstrip(), "outputs": [], "execution_count": None})
        elif language == "text":
            cells[-1]["outputs"] = [{"output_type": "stream", "name": "stdout", "text": block}]
    for number, cell in enumerate(cells):
        cell |= {"id": f"cell-{number}", "metadata": {}}
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
