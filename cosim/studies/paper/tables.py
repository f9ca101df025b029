"""A comparison as a page of texts, marks and footnotes; and that page as Markdown, on a terminal, and as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from rich.console import Console
from rich.table import Column
from rich.text import Text

from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.cosim.reports.text import markdown_table
from flexfmu.cosim.studies.paper.comparison import Cell, ComparisonTable, QuantityComparison, count_agreement
from flexfmu.cosim.studies.paper.printed import Remark

CLOSE, NEAR = 0.005, 0.035
"""Relative errors up to which a cell is graded close (the bound of torque and deflection) and near (RMS errors)."""

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


class Grade(Enum):
    """How a cell is coloured."""

    CLOSE = "close"
    NEAR = "near"
    FAR = "far"
    MISPRINT = "misprint"


@dataclass(frozen=True)
class CellText:
    """A cell as texts: the paper's figure, the computed one, the relative error, the footnotes' marks."""

    paper: str
    computed: str
    difference: str
    marks: str
    grade: Grade


@dataclass(frozen=True)
class QuantityBlock:
    """A quantity: heading with unit and marks, meaning, columns, rows of label and cells."""

    name: str
    unit: str
    marks: str
    meaning: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[CellText, ...]], ...]


@dataclass(frozen=True)
class TablePage:
    """A table of the paper, ready to be laid out.

    Attributes:
        key, label, title: as in `PrintedTable`.
        remarks: what holds for the whole table.
        blocks: its quantities.
        footnotes: mark and text, in the order of the marks.
        summary: the agreement in one sentence.
    """

    key: str
    label: str
    title: str
    remarks: tuple[str, ...]
    blocks: tuple[QuantityBlock, ...]
    footnotes: tuple[tuple[str, str], ...]
    summary: str


def lay_out(table: ComparisonTable) -> TablePage:
    """Turn a comparison into texts with numbered footnotes."""
    remarks = tuple(remark for comparison in table.comparisons for remark in comparison.quantity.remarks)
    footnotes = (f"{remark.verdict.value.capitalize()}: {remark.text}" for remark in remarks)
    return TablePage(
        key=table.printed.key,
        label=table.printed.label,
        title=table.printed.title,
        remarks=table.printed.remarks,
        blocks=tuple(_block(comparison, remarks) for comparison in table.comparisons),
        footnotes=tuple((str(n).translate(_SUPERSCRIPTS), text) for n, text in enumerate(footnotes, 1)),
        summary=count_agreement(table.cells).sentence(),
    )


def percentage(relative: float) -> str:
    """A relative error as text with sign: two decimals below 10 %, none above 1000 %."""
    value = 100 * relative
    decimals = 2 if abs(value) < 9.995 else 1 if abs(value) < 999.5 else 0
    return f"{value:+.{decimals}f}\N{NO-BREAK SPACE}%".replace("-", "\N{MINUS SIGN}")


def _block(comparison: QuantityComparison, remarks: tuple[Remark, ...]) -> QuantityBlock:
    """A quantity's texts; a remark on all of its cells is marked at the heading, the others at their cells."""
    quantity = comparison.quantity

    def marks(chosen: Iterable[Remark], general: bool) -> str:
        # by identity, since two quantities may have remarks of the same wording
        wanted = {id(remark) for remark in chosen if (not remark.rows and not remark.columns) == general}
        numbers = (str(number) for number, remark in enumerate(remarks, 1) if id(remark) in wanted)
        return " ".join(numbers).translate(_SUPERSCRIPTS)

    def text(cell: Cell) -> CellText:
        difference = percentage(cell.relative_error)
        return CellText(cell.printed, cell.rounded(), difference, marks(cell.remarks, general=False), _grade(cell))

    return QuantityBlock(
        name=quantity.name,
        unit=quantity.unit,
        marks=marks(quantity.remarks, general=True),
        meaning=quantity.meaning,
        columns=quantity.columns,
        rows=tuple(
            (row, tuple(text(comparison.cell(row, column)) for column in quantity.columns)) for row in quantity.rows
        ),
    )


def _grade(cell: Cell) -> Grade:
    if not cell.believable:
        return Grade.MISPRINT
    if abs(cell.relative_error) <= CLOSE or cell.agrees_to_the_digits:
        return Grade.CLOSE
    return Grade.NEAR if abs(cell.relative_error) <= NEAR else Grade.FAR


def table_to_markdown(page: TablePage) -> str:
    """One table of the paper: every cell as paper → computed (relative error)."""
    parts = [f"## {page.label}. {page.title}", *page.remarks]
    for block in page.blocks:
        heading = f"**{block.name}** [{block.unit}]{block.marks}: {block.meaning}; paper → computed (relative error)"
        rule = ["---", *("---:" for _ in block.columns)]
        rows = [[label, *map(_markdown_cell, cells)] for label, cells in block.rows]
        parts.append(f"{heading}\n\n{markdown_table(['', *block.columns], rule, rows)}")
    if page.footnotes:
        parts.append("\n".join(f"- {mark} {text}" for mark, text in page.footnotes))
    return "\n\n".join([*parts, f"**{page.summary}**"]) + "\n"


def _markdown_cell(cell: CellText) -> str:
    """``paper → **computed** (relative error)``, a misprint struck out."""
    paper = f"~~{cell.paper}~~" if cell.grade is Grade.MISPRINT else cell.paper
    return f"{paper} → **{cell.computed}** ({cell.difference}){cell.marks}"


_COLOURS = {Grade.CLOSE: "green", Grade.NEAR: "yellow", Grade.FAR: "red", Grade.MISPRINT: "bright_black"}


def print_page(page: TablePage, console: Console) -> None:
    """Print one table of the paper."""
    console.print()
    console.print(Text(f"{page.label}. {page.title}", style="bold"))
    for remark in page.remarks:
        console.print(Text(remark, style="italic"))
    # a table for each quantity
    for block in page.blocks:
        title = f"{block.name} [{block.unit}]{block.marks}: paper → computed"
        table = titled_table(title, "", *(Column(column, justify="right") for column in block.columns))
        for label, cells in block.rows:
            table.add_row(label, *map(_rich_cell, cells))
        console.print(table)
    # what the marks mean, and how well the table agrees
    for mark, text in page.footnotes:
        console.print(Text(f"{mark} {text}", style="dim"))
    console.print(Text(page.summary, style="bold"))


def _rich_cell(cell: CellText) -> Text:
    """``paper → computed (relative error)`` in the colour of the grade, a misprint struck out."""
    difference = cell.difference.replace("\N{NO-BREAK SPACE}", "")  # rich would break the line there
    return Text.assemble(
        (cell.paper, "strike" if cell.grade is Grade.MISPRINT else ""),
        " → ",
        (cell.computed, "bold"),
        (f" ({difference}){cell.marks or ' '}", _COLOURS[cell.grade]),
    )


CSV_COLUMNS = (
    "table",
    "quantity",
    "metric",
    "unit",
    "row",
    "column",
    "paper",
    "computed",
    "relative_error",
    "agrees_to_the_digits",
    "believable",
    "remarks",
)


def table_to_csv(table: ComparisonTable) -> str:
    """All cells of a table with `CSV_COLUMNS` as the first line; figures in the quantity's unit."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    # a line for each cell
    writer.writerow(CSV_COLUMNS)
    for comparison in table.comparisons:
        quantity = comparison.quantity
        for cell in comparison.cells:
            writer.writerow(
                [
                    table.printed.label,
                    quantity.name,
                    quantity.metric,
                    quantity.unit,
                    cell.row,
                    cell.column,
                    cell.printed,
                    f"{cell.computed:.9g}",
                    f"{cell.relative_error:.3e}",
                    str(cell.agrees_to_the_digits).lower(),
                    str(cell.believable).lower(),
                    " ".join(f"{remark.verdict.value}: {remark.text}" for remark in cell.remarks),
                ]
            )
    return text.getvalue()
