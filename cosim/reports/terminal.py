"""Results as text: tables in Markdown, and tables that fit the terminal: no number is ever cut or broken.

Texts wrap between words. Where even that is too wide, the columns go on below, beside the first ones again.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.style import StyleType
from rich.table import Column, Table
from rich.text import Text

if TYPE_CHECKING:
    from flexfmu.cosim.reports.page import Table as PageTable

GAP = 2
"""Spaces between columns where space is short."""

TEXT_WIDTH = 12
"""Wrapped texts get at least this width, if their words are short."""

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


def titled_table(
    title: str, *columns: Column | str, numbers: Iterable[str] = (), keys: int = 1, stacks: bool = False
) -> Table:
    """Return an empty table for the terminal, with a bold title at the left.

    Cells of right-aligned columns never wrap: these are numbers. In a narrow terminal the other columns wrap, and then the table
    goes on below.

    Args:
        title: may be empty.
        columns: their headings, or columns; more may be added.
        numbers: headings of right-aligned columns behind these.
        keys: number of first columns that name a row, and are there again where the table goes on.
        stacks: whether the second column, of names, goes below the words of the first where space is short.
    """
    heads = [each if isinstance(each, Column) else Column(each) for each in columns]
    heads += [Column(each, justify="right") for each in numbers]
    # no markup here either
    for head in heads:
        head.header = Text(head.header) if isinstance(head.header, str) else head.header
    return FittingTable(*heads, title=Text(title), keys=keys, stacks=stacks)


def as_terminal_table(table: PageTable, texts: Collection[str] = ()) -> Table:
    """Return a table of a page for the terminal: the first column, names and those of ``texts`` are texts, the others numbers."""
    first, *others = table.header
    named = others[:1] == ["Name"]
    heads = (each if each in (*texts, "Name") else Column(each, justify="right") for each in others)
    found = titled_table(table.title, first or " ", *heads, stacks=named)
    for row in table.rows:
        found.add_row(*row)
    return found


class FittingTable(Table):
    """The table of `titled_table`: fits the width that it is printed in."""

    def __init__(self, *columns: Column | str, title: Text, keys: int, stacks: bool = False) -> None:
        # an empty title would be a blank line
        super().__init__(
            *columns, box=box.SIMPLE_HEAD, title=title or None, title_justify="left", title_style="bold", pad_edge=False
        )
        self.keys, self.stacks = keys, stacks

    def add_row(
        self, *renderables: RenderableType | None, style: StyleType | None = None, end_section: bool = False
    ) -> None:
        """Add a row, whose texts are no markup: square brackets are units here."""
        cells = (Text(each) if isinstance(each, str) else each for each in renderables)
        super().add_row(*cells, style=style, end_section=end_section)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the table as it is where it fits, else in parts; files that the output goes to have 80 columns for names."""
        width = options.max_width if console.is_terminal or not self.stacks else min(options.max_width, NARROW)
        if self.__rich_measure__(console, options.update(max_width=UNLIMITED)).maximum <= width:
            yield from super().__rich_console__(console, options)
            return
        if self.title:
            yield Text.assemble((str(self.title), "bold"))
        limits = [_limits(column, console, options) for column in self.columns]
        if self.stacks and sum(each.narrowest + GAP for each in limits) - GAP > width:
            yield from self._stacked().__rich_console__(console, options)
            return
        for places in _parts(limits, self.keys, width):
            yield self._part(places, _widths([limits[place] for place in places], width))
            yield ""

    def _stacked(self) -> FittingTable:
        """Return the table with the second column below the first."""
        words, names, *others = self.columns
        cells: list[RenderableType] = [
            Text(f"{word}\n{name}".rstrip()) for word, name in zip(words.cells, names.cells, strict=True)
        ]
        heads = [replace(words, _cells=cells), *others]
        found = FittingTable(*(replace(each, _cells=[]) for each in heads), title=Text(), keys=1)
        for row, texts in zip(self.rows, zip(*(head.cells for head in heads), strict=True), strict=True):
            found.add_row(*texts, style=row.style, end_section=row.end_section)
        return found

    def _part(self, places: Sequence[int], widths: Sequence[int]) -> Table:
        """Return some columns as a table, each with its width."""
        columns = (
            replace(self.columns[place], _cells=[], width=width, no_wrap=False, overflow="fold")
            for place, width in zip(places, widths, strict=True)
        )
        part = Table(*columns, box=self.box, pad_edge=False, show_edge=False, padding=(0, GAP - 1, 0, 0))
        # the rows, with their styles
        cells = [list(self.columns[place].cells) for place in places]
        for row, texts in zip(self.rows, zip(*cells, strict=True), strict=True):
            part.add_row(*texts, style=row.style, end_section=row.end_section)
        return part


class ColumnWidths(NamedTuple):
    """The narrowest and the widest useful width of a column [characters], and whether it may be narrower still."""

    narrowest: int
    widest: int
    folds: bool


def _limits(column: Column, console: Console, options: ConsoleOptions) -> ColumnWidths:
    """Return the limits of a column."""
    unlimited = options.update(max_width=UNLIMITED)
    head = Measurement.get(console, unlimited, column.header)
    cells = [Measurement.get(console, unlimited, cell) for cell in column.cells]
    widest = max([1, head.maximum, *(cell.maximum for cell in cells)])
    # numbers are never broken, their headings are
    if column.justify == "right":
        return ColumnWidths(max([1, head.minimum, *(cell.maximum for cell in cells)]), widest, folds=False)
    words = max([TEXT_WIDTH, head.minimum, *(cell.minimum for cell in cells)])
    return ColumnWidths(min(widest, words), widest, folds=True)


def _parts(limits: Sequence[ColumnWidths], keys: int, width: int) -> list[list[int]]:
    """Return the columns of each part: the keys, and as many of the others as fit beside them."""
    others = range(keys, len(limits))
    widest = max((limits[place].narrowest for place in others), default=0)
    own = sum(limits[place].narrowest + GAP for place in range(keys))
    # keys that leave too little for the widest of the others: the first alone
    if keys > 1 and own + widest > width:
        return _parts(limits, 1, width)
    parts, room = [[*range(keys)]], width - own
    for place in others:
        needed = limits[place].narrowest
        if needed > room and len(parts[-1]) > keys:
            parts.append([*range(keys)])
            room = width - own
        parts[-1].append(place)
        room -= needed + GAP
    return parts


def _widths(limits: Sequence[ColumnWidths], width: int) -> list[int]:
    """Return the width of each column of a part."""
    widths = [each.narrowest for each in limits]
    room = width - sum(widths) - GAP * (len(widths) - 1)
    # what is left goes to the narrowest
    for _ in range(room):
        growing = [i for i, each in enumerate(limits) if widths[i] < each.widest]
        if growing:
            widths[min(growing, key=lambda i: widths[i])] += 1
    # what is missing is taken from the widest texts, whose words break
    for _ in range(-room):
        folding = [i for i, each in enumerate(limits) if each.folds and widths[i] > 1]
        if folding:
            widths[max(folding, key=lambda i: widths[i])] -= 1
    return widths
