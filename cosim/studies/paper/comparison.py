"""The paper's printed tables (`data/*.toml`) and the computed figures side by side, cell by cell, and how many of them agree how closely."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from enum import Enum
from functools import cache
from importlib.resources import files
from typing import Any

from pydantic import TypeAdapter

from flexfmu.cosim.engine.errors import ResultsError

TABLES = (
    "table-02",
    "table-05",
    "table-06",
    "frequencies",
    "table-07",
    "table-08",
    "table-09",
    "table-10",
    "table-11",
)
"""Data files in the order in which the report shows them."""


class Verdict(Enum):
    """Assessment of a printed figure, with a sentence for the reader."""

    MISPRINT = "misprint"
    UNEXPLAINED = "unexplained"
    IDENTIFIED = "identified"
    NOTE = "note"

    @property
    def sentence(self) -> str:
        """The meaning of the verdict."""
        return {
            Verdict.MISPRINT: "the printed figure can't be right",
            Verdict.UNEXPLAINED: "not reproducible from the paper's text",
            Verdict.IDENTIFIED: "rests on a value that the paper doesn't give",
            Verdict.NOTE: "how to read the figure",
        }[self]


@dataclass(frozen=True)
class Remark:
    """A remark on some cells of a quantity; empty ``rows`` or ``columns`` mean all of them."""

    text: str
    verdict: Verdict
    rows: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()

    def concerns(self, row: str, column: str) -> bool:
        """Whether the remark is about this cell."""
        return (not self.rows or row in self.rows) and (not self.columns or column in self.columns)


@dataclass(frozen=True)
class PrintedQuantity:
    """One block of a table: a quantity printed for rows and columns.

    Attributes:
        name, unit, meaning: the paper's name, the unit of ``values``, what is computed to compare with them.
        metric: name of the computed number (SI), which ``scale`` converts to ``unit``.
        rows, columns: labels as printed.
        values: figures as printed, so that their digits are kept, ``values[row][column]``.
        remarks: remarks on cells.
    """

    name: str
    unit: str
    meaning: str
    metric: str
    scale: float
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    values: tuple[tuple[str, ...], ...]
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True)
class PrintedTable:
    """A table of the paper.

    Attributes:
        key: name of the data file without its suffix.
        label, title: for example ``Table 7`` and its caption.
        quantities: the blocks of the table.
        scene: name of the shipped scene simulated for it; empty for tables of trajectories alone.
        remarks: what holds for the whole table.
    """

    key: str
    label: str
    title: str
    quantities: tuple[PrintedQuantity, ...]
    scene: str = ""
    remarks: tuple[str, ...] = ()


def read_data(name: str) -> dict[str, Any]:
    """Read ``data/<name>.toml`` of this package."""
    return tomllib.loads(
        files("flexfmu.cosim.studies.paper").joinpath("data", f"{name}.toml").read_text(encoding="utf-8")
    )


@cache
def printed_table(key: str) -> PrintedTable:
    """Read one table of `TABLES`."""
    data = read_data(key)
    # labels of rows and columns are those of the table unless the block has its own
    shared = {"rows": data["rows"], "columns": data["columns"]}
    quantities = [shared | block for block in data["quantities"]]
    table = {**data, "key": key, "label": data["table"], "quantities": quantities}
    return TypeAdapter(PrintedTable).validate_python(table)


def printed_tables() -> tuple[PrintedTable, ...]:
    """All tables, in the order of the report."""
    return tuple(printed_table(key) for key in TABLES)


CLOSE, NEAR = 0.005, 0.035
"""Relative errors up to which a cell is graded close (the bound of torque and deflection) and near (RMS errors)."""

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


class Grade(Enum):
    """How a cell is coloured."""

    CLOSE = "close"
    NEAR = "near"
    FAR = "far"
    MISPRINT = "misprint"


EvaluateCell = Callable[[str, str], float]
"""Computed value [SI] of a cell from its row's and its column's label."""


@dataclass(frozen=True)
class Cell:
    """One figure of the paper beside the computed one, both in the quantity's unit.

    Attributes:
        printed: the figure as printed.
        computed: the computed figure.
        remarks: remarks on this cell.
    """

    row: str
    column: str
    printed: str
    computed: float
    remarks: tuple[Remark, ...]

    @property
    def relative_error(self) -> float:
        """Computed / printed - 1."""
        return self.computed / float(self.printed) - 1.0

    @property
    def decimals(self) -> int:
        """Number of printed decimals."""
        exponent = Decimal(self.printed).as_tuple().exponent
        return max(0, -exponent) if isinstance(exponent, int) else 0

    @property
    def agrees_to_the_digits(self) -> bool:
        """Whether the computed figure, rounded to the printed digits, equals the printed one."""
        return abs(self.computed - float(self.printed)) <= 0.5000001 * 10.0**-self.decimals

    @property
    def believable(self) -> bool:
        """Whether the printed figure can be right."""
        return all(remark.verdict is not Verdict.MISPRINT for remark in self.remarks)

    @property
    def grade(self) -> Grade:
        """How near the computed figure is to the printed one."""
        if not self.believable:
            return Grade.MISPRINT
        if abs(self.relative_error) <= CLOSE or self.agrees_to_the_digits:
            return Grade.CLOSE
        return Grade.NEAR if abs(self.relative_error) <= NEAR else Grade.FAR

    def rounded(self) -> str:
        """The computed figure with one more decimal than printed."""
        return f"{self.computed:.{self.decimals + 1}f}"

    def difference(self) -> str:
        """The relative error as text."""
        return percentage(self.relative_error)

    def to_dict(self) -> dict[str, Any]:
        """The cell for JSON; ``paper`` and ``computed`` in the quantity's unit."""
        return {
            "row": self.row,
            "column": self.column,
            "paper": float(self.printed),
            "printed": self.printed,
            "computed": self.computed,
            "relative_error": self.relative_error,
            "agrees_to_the_digits": self.agrees_to_the_digits,
            "believable": self.believable,
            "remarks": [{"verdict": remark.verdict.value, "text": remark.text} for remark in self.remarks],
        }


def percentage(relative: float) -> str:
    """A relative error as text with sign: two decimals below 10 %, none above 1000 %."""
    value = 100 * relative
    decimals = 2 if abs(value) < 9.995 else 1 if abs(value) < 999.5 else 0
    return f"{value:+.{decimals}f}\N{NO-BREAK SPACE}%".replace("-", "\N{MINUS SIGN}")


@dataclass(frozen=True)
class QuantityComparison:
    """A printed quantity with its cells, row by row."""

    quantity: PrintedQuantity
    cells: tuple[Cell, ...]

    def rows(self) -> list[tuple[str, list[Cell]]]:
        """Label and cells of each row."""
        columns = self.quantity.columns
        return [(row, [self.cell(row, column) for column in columns]) for row in self.quantity.rows]

    def cell(self, row: str, column: str) -> Cell:
        """The cell of a row and a column.

        Raises:
            KeyError: no such cell.
        """
        return {(cell.row, cell.column): cell for cell in self.cells}[row, column]

    def to_dict(self) -> dict[str, Any]:
        """The quantity and its cells for JSON."""
        return {
            "name": self.quantity.name,
            "metric": self.quantity.metric,
            "unit": self.quantity.unit,
            "meaning": self.quantity.meaning,
            "cells": [cell.to_dict() for cell in self.cells],
        }


@dataclass(frozen=True)
class ComparisonTable:
    """A table of the paper with all its quantities computed."""

    printed: PrintedTable
    comparisons: tuple[QuantityComparison, ...]

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The cells of all quantities."""
        return tuple(cell for comparison in self.comparisons for cell in comparison.cells)

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """The remarks on all quantities, numbered from 1 in this order."""
        return tuple(remark for comparison in self.comparisons for remark in comparison.quantity.remarks)

    def footnotes(self) -> list[tuple[str, str]]:
        """Mark and text of each remark."""
        texts = (f"{remark.verdict.value.capitalize()}: {remark.text}" for remark in self.remarks)
        return [(str(number).translate(_SUPERSCRIPTS), text) for number, text in enumerate(texts, 1)]

    def marks(self, of: PrintedQuantity | Cell) -> str:
        """The numbers of the remarks on a cell; those on all cells of a quantity stand at its heading alone."""
        # by identity, since two quantities may have remarks of the same wording
        general = isinstance(of, PrintedQuantity)
        wanted = {id(remark) for remark in of.remarks if (not remark.rows and not remark.columns) == general}
        numbers = (str(number) for number, remark in enumerate(self.remarks, 1) if id(remark) in wanted)
        return " ".join(numbers).translate(_SUPERSCRIPTS)

    def summary(self) -> str:
        """The agreement in one sentence."""
        return count_agreement(self.cells).sentence()

    def comparison(self, metric: str) -> QuantityComparison:
        """The comparison of a quantity by its metric's name.

        Raises:
            KeyError: the table doesn't have it.
        """
        return {comparison.quantity.metric: comparison for comparison in self.comparisons}[metric]

    def to_dict(self) -> dict[str, Any]:
        """The table for JSON."""
        return {
            "key": self.printed.key,
            "label": self.printed.label,
            "title": self.printed.title,
            "scene": self.printed.scene or None,
            "remarks": list(self.printed.remarks),
            "quantities": [comparison.to_dict() for comparison in self.comparisons],
        }


def compare(table: PrintedTable, evaluate: Mapping[str, EvaluateCell]) -> ComparisonTable:
    """Compute every cell of a table.

    Args:
        table: the printed table.
        evaluate: for each metric of the table, the function that computes its cells in SI units.

    Raises:
        ResultsError: a computed figure is not finite.
    """
    comparisons = []
    for quantity in table.quantities:
        cells = []
        for row, figures in zip(quantity.rows, quantity.values, strict=True):
            for column, printed in zip(quantity.columns, figures, strict=True):
                # evaluators work in SI, tables in their own units
                computed = quantity.scale * evaluate[quantity.metric](row, column)
                if not math.isfinite(computed):
                    where = f"{table.label}, {quantity.name}, {row}, {column}"
                    raise ResultsError(f"{where}: the computed figure is {computed}; look at the simulation's results")
                remarks = tuple(remark for remark in quantity.remarks if remark.concerns(row, column))
                cells.append(Cell(row, column, printed, computed, remarks))
        comparisons.append(QuantityComparison(quantity, tuple(cells)))
    return ComparisonTable(table, tuple(comparisons))


BOUNDS = (0.001, 0.005, 0.01, 0.035, 0.10)
"""Relative errors within which cells are counted: 0.1 %, 0.5 %, 1 %, 3.5 % and 10 %."""


@dataclass(frozen=True)
class Agreement:
    """Count of the cells whose relative error stays within each of `BOUNDS`.

    Attributes:
        compared: number of cells whose printed figure can be right.
        within: number of these within each bound.
        to_the_digits: number of these equal to the printed figure when rounded like it.
        misprinted: number of further cells whose printed figure can't be right.
    """

    compared: int
    within: tuple[int, ...]
    to_the_digits: int
    misprinted: int

    def sentence(self) -> str:
        """The counts in one sentence."""
        if not self.compared:
            return f"{_count_of_cells(self.misprinted)} misprinted."
        more = f"; {_count_of_cells(self.misprinted)} misprinted and not counted" if self.misprinted else ""
        # only bounds that add cells
        steps = [
            f"{count} within {100 * bound:g} %"
            for previous, count, bound in zip((0, *self.within), self.within, BOUNDS, strict=False)
            if count > previous
        ]
        counts = ", ".join(steps or ["none within 10 %"])
        return f"Of {self.compared} cells, {counts} ({self.to_the_digits} to the printed digits){more}."

    def to_dict(self) -> dict[str, Any]:
        """The counts for JSON."""
        return {
            "compared": self.compared,
            "within": {f"{bound:g}": count for bound, count in zip(BOUNDS, self.within, strict=True)},
            "to_the_digits": self.to_the_digits,
            "misprinted": self.misprinted,
        }


def count_agreement(cells: Iterable[Cell]) -> Agreement:
    """Count the cells within each of `BOUNDS`; misprinted cells are counted separately."""
    cells = tuple(cells)
    believable = [cell for cell in cells if cell.believable]
    return Agreement(
        compared=len(believable),
        within=tuple(sum(abs(cell.relative_error) <= bound for cell in believable) for bound in BOUNDS),
        to_the_digits=sum(cell.agrees_to_the_digits for cell in believable),
        misprinted=len(cells) - len(believable),
    )


def _count_of_cells(count: int) -> str:
    return "1 cell is" if count == 1 else f"{count} cells are"
