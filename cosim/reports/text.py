"""Results as text: JSON, and tables for the terminal and in Markdown."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Column, Table


def to_json(data: Mapping[str, Any]) -> str:
    """JSON text that ends with a line break; refuses NaN and infinity, which JSON doesn't know."""
    return json.dumps(data, ensure_ascii=False, indent=2, allow_nan=False) + "\n"


def titled_table(title: str, *columns: Column | str, expand: bool = False) -> Table:
    """An empty table for the terminal, its title in bold at the left."""
    return Table(*columns, box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold", expand=expand)


def markdown_table(head: Sequence[str], rule: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, without a line break at its end.

    Args:
        head: headings of the columns.
        rule: for each column ``---`` or ``:--``, or ``---:`` or ``--:`` for figures.
        rows: cells, in which nothing is escaped.
    """
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rule, *rows))
