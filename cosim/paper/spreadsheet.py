"""A table as CSV, one line a cell."""

from __future__ import annotations

import csv
import io

from flexfmu.cosim.paper.comparison import Cell, Comparison, ComparisonTable

COLUMNS = (
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
    """All cells of a table with `COLUMNS` as the first line; figures in the quantity's unit."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for comparison in table.comparisons:
        writer.writerows(_line(table, comparison, cell) for cell in comparison.cells)
    return text.getvalue()


def _line(table: ComparisonTable, comparison: Comparison, cell: Cell) -> list[str]:
    quantity = comparison.quantity
    return [
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
