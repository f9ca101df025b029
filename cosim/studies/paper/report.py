"""The result of `flexfmu paper`: tables beside the printed ones, and figures; as files, one offline page, and on a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pydantic import TypeAdapter
from rich.console import Console
from rich.text import Text

from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.cosim.engine.rows import csv_text
from flexfmu.cosim.reports.page import render
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.cosim.reports.text import markdown_table, to_json
from flexfmu.cosim.studies.paper.comparison import (
    Agreement,
    Cell,
    ComparisonTable,
    Grade,
    count_agreement,
    read_data,
)


def table_to_markdown(table: ComparisonTable) -> str:
    """One table of the paper: every cell as paper → computed (relative error)."""
    parts = [f"## {table.printed.label}. {table.printed.title}", *table.printed.remarks]
    for comparison in table.comparisons:
        quantity = comparison.quantity
        name = f"**{quantity.name}** [{quantity.unit}]{table.marks(quantity)}"
        heading = f"{name}: {quantity.meaning}; paper → computed (relative error)"
        rule = ["---", *("---:" for _ in quantity.columns)]
        rows = [
            [label, *(_markdown_cell(cell, table.marks(cell)) for cell in cells)] for label, cells in comparison.rows()
        ]
        parts.append(f"{heading}\n\n{markdown_table(['', *quantity.columns], rule, rows)}")
    if table.remarks:
        parts.append("\n".join(f"- {mark} {text}" for mark, text in table.footnotes()))
    return "\n\n".join([*parts, f"**{table.summary()}**"]) + "\n"


def _markdown_cell(cell: Cell, marks: str) -> str:
    """``paper → **computed** (relative error)``, a misprint struck out."""
    paper = f"~~{cell.printed}~~" if cell.grade is Grade.MISPRINT else cell.printed
    return f"{paper} → **{cell.rounded()}** ({cell.difference()}){marks}"


_COLOURS = {Grade.CLOSE: "green", Grade.NEAR: "yellow", Grade.FAR: "red", Grade.MISPRINT: "bright_black"}


def print_table(table: ComparisonTable, console: Console) -> None:
    """Print one table of the paper."""
    console.print()
    console.print(Text(f"{table.printed.label}. {table.printed.title}", style="bold"))
    for remark in table.printed.remarks:
        console.print(Text(remark, style="italic"))
    # a table for each quantity
    for comparison in table.comparisons:
        quantity = comparison.quantity
        title = f"{quantity.name} [{quantity.unit}]{table.marks(quantity)}: paper → computed"
        shown = titled_table(title, "", numbers=quantity.columns)
        for label, cells in comparison.rows():
            shown.add_row(label, *(_rich_cell(cell, table.marks(cell)) for cell in cells))
        console.print(shown)
    # what the marks mean, and how well the table agrees
    for mark, text in table.footnotes():
        console.print(Text(f"{mark} {text}", style="dim"))
    console.print(Text(table.summary(), style="bold"))


def _rich_cell(cell: Cell, marks: str) -> Text:
    """``paper → computed (relative error)`` in the colour of the grade, a misprint struck out."""
    difference = cell.difference().replace("\N{NO-BREAK SPACE}", "")  # rich would break the line there
    return Text.assemble(
        (cell.printed, "strike" if cell.grade is Grade.MISPRINT else ""),
        " → ",
        (cell.rounded(), "bold"),
        (f" ({difference}){marks or ' '}", _COLOURS[cell.grade]),
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
class PaperSource:
    """Bibliographic data of the paper, and what holds for the reproduction as a whole."""

    authors: tuple[str, ...]
    title: str
    event: str
    number: str
    doi: str
    url: str
    remarks: tuple[str, ...]

    @property
    def citation(self) -> str:
        """The source in one line."""
        return f"{', '.join(self.authors)}: {self.title}. {self.event}, paper {self.number}, doi:{self.doi}"


@cache
def source() -> PaperSource:
    """The paper itself."""
    return TypeAdapter(PaperSource).validate_python(read_data("source"))


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
        tables = [table_to_markdown(table) for table in self.tables]
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
        tables=report.tables,
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
        print_table(table, console)
    console.print()
    console.print(Text(report.summary(), style="bold"))
