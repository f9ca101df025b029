"""Results as text: tables in Markdown, and tables that fit the terminal: no number is ever cut or broken.

Texts wrap between words. Where even that is too wide, each row is a block of lines.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.style import StyleType
from rich.table import Column, Table
from rich.text import Text

if TYPE_CHECKING:
    from flexfmu.cosim.reports.page import Table as PageTable

TEXT_WIDTH = 12
"""Wrapped texts get at least this width, if their words are short."""

NARROW_PADDING = (0, 1, 0, 0)
"""Around cells where space is short: top, right, bottom, left."""

NARROW = 80
"""Columns of the narrowest terminals."""

UNLIMITED = 10_000
"""A width that holds everything."""


def markdown_table(head: Sequence[str], rule: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, without a final line break.

    Args:
        head: headings of the columns.
        rule: alignment of each column: ``---`` or ``:--`` for text, ``---:`` or ``--:`` for numbers.
        rows: cells of each row, already escaped.
    """
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rule, *rows))


def titled_table(title: str, *columns: Column | str, numbers: Iterable[str] = (), stacks: bool = False) -> Table:
    """Return an empty table for the terminal, with a bold title at the left.

    Cells of right-aligned columns never wrap: these are numbers. In a narrow terminal the other columns wrap.

    Args:
        title: may be empty.
        columns: their headings, or columns; more may be added.
        numbers: headings of right-aligned columns behind these.
        stacks: whether the second column, of names, goes below the words of the first where space is short.
    """
    heads = [each if isinstance(each, Column) else Column(each) for each in columns]
    heads += [Column(each, justify="right") for each in numbers]
    # no markup here either
    for head in heads:
        head.header = Text(head.header) if isinstance(head.header, str) else head.header
    return FittingTable(*heads, title=Text(title), stacks=stacks)


def as_terminal_table(table: PageTable, texts: Collection[str] = ()) -> Table:
    """Return a table of a page for the terminal: the first column, names and those of ``texts`` are texts, the others numbers.

    Units of numbers stand below their names.
    """
    first, *others = table.header
    named = others[:1] == ["Name"]
    heads = (
        each if each in (*texts, "Name") else Column(each.replace(" [", "\n["), justify="right") for each in others
    )
    found = titled_table(table.title, first or " ", *heads, stacks=named)
    for row in table.rows:
        found.add_row(*row)
    return found


class FittingTable(Table):
    """The table of `titled_table`: fits the width that it is printed in."""

    def __init__(self, *columns: Column | str, title: Text, stacks: bool = False) -> None:
        # an empty title would be a blank line
        super().__init__(
            *columns, box=box.SIMPLE_HEAD, title=title or None, title_justify="left", title_style="bold", pad_edge=False
        )
        self.stacks = stacks

    def add_row(
        self, *renderables: RenderableType | None, style: StyleType | None = None, end_section: bool = False
    ) -> None:
        """Add a row, whose texts are no markup: square brackets are units here."""
        cells = (Text(each) if isinstance(each, str) else each for each in renderables)
        super().add_row(*cells, style=style, end_section=end_section)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the table, or its rows as blocks; files that the output goes to have 80 columns for names."""
        width = options.max_width if console.is_terminal or not self.stacks else min(options.max_width, NARROW)
        for table in (self, *([self._stacked()] if self.stacks else [])):
            for is_narrow in (False, True):
                if is_narrow:
                    table.padding, table.show_edge = NARROW_PADDING, False
                if table._fits(console, options, width):
                    yield from Table.__rich_console__(table, console, options.update(max_width=width))
                    return
        if self.title:
            yield Text.assemble((str(self.title), "bold"))
        # texts before the first number name the row
        names = next((i for i, each in enumerate(self.columns) if i and each.justify == "right"), 1)
        for row, *cells in zip(self.rows, *(each.cells for each in self.columns), strict=True):
            yield Text(", ".join(filter(None, map(str, cells[:names]))), style=row.style or "")
            for column, cell in zip(self.columns[names:], cells[names:], strict=True):
                shown = cell if isinstance(cell, Text) else str(cell)
                yield Text.assemble(f"  {column.header}: ".replace("\n", " "), shown, style=row.style or "")
            yield ""

    def _fits(self, console: Console, options: ConsoleOptions, width: int) -> bool:
        """Whether the table is no wider than that, with texts that wrap between words and numbers that don't."""
        unlimited, words, texts = options.update(max_width=UNLIMITED), TEXT_WIDTH, list[int]()
        for column in self.columns:
            column.no_wrap = column.justify == "right"
            if not column.no_wrap:
                sizes = [Measurement.get(console, unlimited, each) for each in (column.header, *column.cells)]
                words = max(words, *(each.minimum for each in sizes))
                texts.append(max(each.maximum for each in sizes))
        spare = sum(max(0, each - words) for each in texts)
        return self.__rich_measure__(console, unlimited).maximum - spare <= width

    def _stacked(self) -> FittingTable:
        """Return the table with the second column below the first."""
        found, (words, names, *others) = copy(self), self.columns
        pairs = zip(words.cells, names.cells, strict=True)
        first = replace(words, _cells=[Text(f"{word}\n{name}".rstrip()) for word, name in pairs])
        found.columns = [replace(each, _index=place) for place, each in enumerate([first, *others])]
        return found
