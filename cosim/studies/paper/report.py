"""The result of `flexfmu paper`: tables beside the printed ones, and figures; as files, one offline page, and on a terminal.

A comparison as a page of texts, marks and footnotes; and that page as Markdown, on a terminal, and as CSV.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rich.console import Console
from rich.text import Text

from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.cosim.reports.page import render
from flexfmu.cosim.reports.rows import csv_text
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.cosim.reports.text import markdown_table, to_json
from flexfmu.cosim.studies.paper.comparison import (
    Agreement,
    Cell,
    ComparisonTable,
    PaperSource,
    QuantityComparison,
    Remark,
    count_agreement,
)

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
        table = titled_table(title, "", numbers=block.columns)
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


def table_to_csv(table: ComparisonTable) -> str:
    """All cells of a table, with a line of names; figures in the quantity's unit."""
    return csv_text(
        [
            {
                "table": table.printed.label,
                "quantity": comparison.quantity.name,
                "metric": comparison.quantity.metric,
                "unit": comparison.quantity.unit,
                "row": cell.row,
                "column": cell.column,
                "paper": cell.printed,
                "computed": f"{cell.computed:.9g}",
                "relative_error": f"{cell.relative_error:.3e}",
                "agrees_to_the_digits": str(cell.agrees_to_the_digits).lower(),
                "believable": str(cell.believable).lower(),
                "remarks": " ".join(f"{remark.verdict.value}: {remark.text}" for remark in cell.remarks),
            }
            for comparison in table.comparisons
            for cell in comparison.cells
        ]
    )


@dataclass(frozen=True)
class PaperFigure:
    """A drawn figure.

    Attributes:
        key: file name without suffix, for example ``figure-06``.
        label, caption: for example ``Figure 6`` and one sentence.
        folder: folder of its files within the report's folder; empty for that folder itself.
    """

    key: str
    label: str
    caption: str
    folder: str = "figures"

    def file(self, suffix: str) -> str:
        """Path of the figure's file within the report's folder; ``suffix`` is ``.png`` or ``.svg``."""
        return f"{self.folder}/{self.key}{suffix}" if self.folder else f"{self.key}{suffix}"


@dataclass(frozen=True)
class PaperReport:
    """The results computed so far.

    Attributes:
        source: the paper.
        tables: comparisons in the order of the report.
        figures: the figures drawn, in the order of the report.
        overview: the figure that summarises the experiment.
        timing: wall-clock time of the parts in seconds.
        versions: versions of packages, platform and compiler; None if unknown.
    """

    source: PaperSource
    tables: tuple[ComparisonTable, ...] = ()
    figures: tuple[PaperFigure, ...] = ()
    overview: PaperFigure | None = None
    timing: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str | None] = field(default_factory=dict)

    def table(self, key: str) -> ComparisonTable:
        """A table by the key of its data file, for example ``table-07``.

        Raises:
            KeyError: it has not been computed.
        """
        return {table.printed.key: table for table in self.tables}[key]

    @property
    def agreement(self) -> Agreement:
        """The agreement over all tables."""
        return count_agreement(cell for table in self.tables for cell in table.cells)

    def summary(self) -> str:
        """The agreement over all tables in one sentence."""
        return f"All tables: {self.agreement.sentence()}"

    def to_markdown(self) -> str:
        """The whole report; figures are referred to by their relative paths."""
        head = ["# The paper's experiment, printed and computed", f"Printed figures: {self.source.citation}."]
        remarks = "\n".join(f"- {remark}" for remark in self.source.remarks)
        tables = [table_to_markdown(lay_out(table)) for table in self.tables]
        figures = [f"![{figure.label}. {figure.caption}]({figure.file('.png')})" for figure in self.figures]
        return "\n\n".join([*head, remarks, f"**{self.summary()}**", *tables, *figures]).rstrip() + "\n"

    def to_json(self) -> str:
        """The whole report as JSON; figures in the unit of their quantity."""
        return to_json(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The whole report as plain data."""
        return {
            "source": {"citation": self.source.citation, "doi": self.source.doi, "url": self.source.url},
            "remarks": list(self.source.remarks),
            "agreement": self.agreement.to_dict(),
            "tables": [table.to_dict() for table in self.tables],
            "figures": [{"key": f.key, "label": f.label, "caption": f.caption} for f in self.figures],
            "timing": dict(self.timing),
            "versions": dict(self.versions),
        }


def report_to_html(report: PaperReport, folder: Path) -> str:
    """Render the report.

    Args:
        report: what has been computed.
        folder: where its figures have been written.
    """
    # the page embeds its figures, so that one file is the whole report
    return render(
        "paper.html.j2",
        source=report.source,
        summary=report.summary(),
        pages=[lay_out(table) for table in report.tables],
        figures=[_embedded(figure, folder) for figure in report.figures],
        overview=_embedded(report.overview, folder) if report.overview else None,
        timing=report.timing,
        versions=report.versions,
    )


KEPT = " !$()*+,-./:;=?@[]_~"
"""Characters of a data URL that aren't encoded; base64 would be a third longer."""


def _embedded(figure: PaperFigure, folder: Path) -> dict[str, Any]:
    """The figure with its SVG file as a data URL: identifiers of different figures can't clash."""
    drawing = (folder / figure.file(".svg")).read_text(encoding="utf-8")
    return {
        "key": figure.key,
        "label": figure.label,
        "caption": figure.caption,
        "image": f"data:image/svg+xml,{quote(drawing.replace(chr(10), ' '), safe=KEPT)}",
    }


def write_report(report: PaperReport, folder: Path) -> None:
    """Write what is known of the report: page, Markdown, JSON, and every table as CSV.

    Raises:
        ResultsError: the folder can't be written.
    """
    for table in report.tables:
        OutputFolder(folder / "tables").write(f"{table.printed.key}.csv", table_to_csv(table))
    OutputFolder(folder).write("paper.md", report.to_markdown())
    OutputFolder(folder).write("paper.json", report.to_json())
    OutputFolder(folder).write("report.html", report_to_html(report, folder))


def print_report(report: PaperReport, console: Console) -> None:
    """Print every table of a report, its footnotes and the summary."""
    console.print(Text(report.source.citation, style="italic"))
    for table in report.tables:
        print_page(lay_out(table), console)
    console.print()
    console.print(Text(report.summary(), style="bold"))
