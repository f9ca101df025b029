"""The report's tables on a terminal, with rich."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.paper.layout import Block, CellText, Grade, Page, lay_out
from flexfmu.cosim.paper.report import PaperReport

_COLOURS = {Grade.CLOSE: "green", Grade.NEAR: "yellow", Grade.FAR: "red", Grade.MISPRINT: "bright_black"}


def print_report(report: PaperReport, console: Console) -> None:
    """Print every table of a report, its footnotes and the summary."""
    console.print(Text(report.source.citation, style="italic"))
    for table in report.tables:
        print_page(lay_out(table), console)
    console.print()
    console.print(Text(report.summary(), style="bold"))


def print_page(page: Page, console: Console) -> None:
    """Print one table of the paper."""
    console.print()
    console.print(Text(f"{page.label}. {page.title}", style="bold"))
    for remark in page.remarks:
        console.print(Text(remark, style="italic"))
    for block in page.blocks:
        console.print(_table(block))
    for mark, text in page.footnotes:
        console.print(Text(f"{mark} {text}", style="dim"))
    console.print(Text(page.summary, style="bold"))


def _table(block: Block) -> Table:
    title = Text(f"{block.name} [{block.unit}]{block.marks}: paper → computed", style="italic")
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left")
    table.add_column("")
    for column in block.columns:
        table.add_column(column, justify="right")
    for label, cells in block.rows:
        table.add_row(label, *(_cell(cell) for cell in cells))
    return table


def _cell(cell: CellText) -> Text:
    difference = cell.difference.replace("\N{NO-BREAK SPACE}", "")  # rich would break the line there
    return Text.assemble(
        (cell.paper, "strike" if cell.grade is Grade.MISPRINT else ""),
        " → ",
        (cell.computed, "bold"),
        (f" ({difference}){cell.marks or ' '}", _COLOURS[cell.grade]),
    )
