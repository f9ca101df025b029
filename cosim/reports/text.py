"""Results as text: JSON and tables in Markdown."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def to_json(data: Mapping[str, Any]) -> str:
    """Return JSON text with a final line break; raise ValueError for NaN and infinity, which JSON doesn't have."""
    return json.dumps(data, ensure_ascii=False, indent=2, allow_nan=False) + "\n"


def markdown_table(head: Sequence[str], rule: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, without a final line break.

    Args:
        head: headings of the columns.
        rule: alignment of each column: ``---`` or ``:--`` for text, ``---:`` or ``--:`` for numbers.
        rows: cells of each row, already escaped.
    """
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rule, *rows))
