"""Tables for the terminal."""

from __future__ import annotations

from rich import box
from rich.table import Column, Table


def titled_table(title: str, *columns: Column | str, expand: bool = False) -> Table:
    """Return an empty table for the terminal, with a bold title at the left."""
    return Table(*columns, box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold", expand=expand)
