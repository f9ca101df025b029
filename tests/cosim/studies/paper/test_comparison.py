"""Comparing, counting and laying out, with figures that are known."""

from __future__ import annotations

import csv
import io
import json
import math

import pytest
from rich.console import Console

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.studies.paper.comparison import (
    Cell,
    ComparisonTable,
    Verdict,
    compare,
    count_agreement,
    percentage,
    printed_table,
)
from flexfmu.cosim.studies.paper.report import PaperReport, print_report, source, table_to_csv, table_to_markdown


def compare_with_itself(key: str, factor: float = 1.0) -> ComparisonTable:
    """A table compared with its own figures times ``factor``."""
    table = printed_table(key)

    def evaluate(metric: str, row: str, column: str) -> float:
        quantity = next(quantity for quantity in table.quantities if quantity.metric == metric)
        printed = quantity.values[quantity.rows.index(row)][quantity.columns.index(column)]
        return factor * float(printed) / quantity.scale

    metrics = [quantity.metric for quantity in table.quantities]
    return compare(table, {metric: lambda row, column, m=metric: evaluate(m, row, column) for metric in metrics})


def cell(printed: str, computed: float) -> Cell:
    return Cell("row", "column", printed, computed, ())


@pytest.mark.parametrize(
    ("printed", "computed", "agrees"),
    [
        ("0.3843", 0.38434, True),
        ("0.3843", 0.38436, False),
        ("58", 57.6, True),
        ("58", 57.4, False),
        ("0.09700", 0.097004, True),
        ("0.09700", 0.097006, False),
    ],
)
def test_digits_are_those_printed(printed: str, computed: float, agrees: bool) -> None:
    """A figure agrees to its digits when it rounds to the printed one, trailing zeros included."""
    assert cell(printed, computed).agrees_to_the_digits is agrees


def test_relative_error_is_computed_over_printed() -> None:
    """The sign convention of every table: positive where the computed figure is larger."""
    assert cell("2.0", 2.1).relative_error == pytest.approx(0.05)


def test_scale_converts_to_the_printed_unit() -> None:
    """Millimetres are compared with millimetres."""
    comparison = compare_with_itself("table-07").comparison("peak_modal_deflection_1")
    assert comparison.cell("Bang-bang", "Polar").computed == pytest.approx(0.06681)


def test_a_figure_that_is_not_finite_is_an_error() -> None:
    """NaN would pass every comparison of bounds unnoticed."""
    with pytest.raises(ResultsError, match=r"Table 2, Blend length, Lamé, Length: .* nan"):
        compare(printed_table("table-02"), {"blend_length": lambda row, column: math.nan})


def test_misprinted_cells_are_not_counted_as_compared() -> None:
    """Neither agreement nor disagreement with a misprint says anything."""
    agreement = count_agreement(compare_with_itself("table-07").cells)
    assert (agreement.compared, agreement.misprinted) == (35, 1)
    assert agreement.within[0] == agreement.to_the_digits == 35
    assert "35 within 0.1 %" in agreement.sentence()
    assert "1 cell is misprinted and not counted" in agreement.sentence()


def test_agreement_counts_within_each_bound() -> None:
    """A cell 3 % off is within 3.5 % and 10 % only."""
    agreement = count_agreement([cell("1.0000", 1.03), cell("1.0000", 0.9999)])
    assert agreement.within == (1, 1, 1, 2, 2)


def test_remarks_reach_their_cells() -> None:
    """The misprint of Table 7 is marked in its cell and explained below the table."""
    table = compare_with_itself("table-07")
    misprint = table.comparison("peak_modal_deflection_1").cell("1/8 Trapezoidal", "Polar")
    assert any(remark.verdict is Verdict.MISPRINT and "0.15813" in remark.text for remark in misprint.remarks)
    assert "0.15813" in table_to_markdown(table)


@pytest.mark.parametrize(
    ("relative", "text"),
    [
        (0.00123, "+0.12\N{NO-BREAK SPACE}%"),
        (-0.1523, "−15.2\N{NO-BREAK SPACE}%"),
        (12.0, "+1200\N{NO-BREAK SPACE}%"),
        (0.0, "+0.00\N{NO-BREAK SPACE}%"),
    ],
)
def test_percentages_are_signed(relative: float, text: str) -> None:
    """Relative errors read the same in every table."""
    assert percentage(relative) == text


def test_json_has_both_numbers_of_every_cell() -> None:
    """A script finds paper, computed and relative error of all 36 cells."""
    report = PaperReport(source(), (compare_with_itself("table-09", 1.01),))
    cells = [c for q in json.loads(report.to_json())["tables"][0]["quantities"] for c in q["cells"]]
    assert len(cells) == 36
    assert all(c["relative_error"] == pytest.approx(0.01) for c in cells)
    assert all(c["computed"] == pytest.approx(1.01 * c["paper"]) for c in cells)


def test_csv_has_one_line_for_each_cell() -> None:
    """A spreadsheet gets every cell with its remarks."""
    lines = list(csv.DictReader(table_to_csv(compare_with_itself("table-11")).splitlines()))
    assert len(lines) == 52
    assert float(lines[0]["paper"]) == 0.3843


@pytest.mark.parametrize("width", [60, 80, 120, 140])
def test_terminal_shows_every_figure_and_remark(width: int) -> None:
    """What is printed for people lacks nothing of what is written to files, whole at each width of the terminal."""
    console = Console(width=width, record=True, file=io.StringIO())
    table = compare_with_itself("table-06")
    print_report(PaperReport(source(), (table,)), console)
    text = console.export_text()
    assert all(f"{cell.printed} → {cell.rounded()}" in text for cell in table.cells)
    assert "…" not in text
    assert all(len(line) <= width for line in text.splitlines())
    assert "All tables" in text
