"""The printed tables are complete and readable."""

from __future__ import annotations

import pytest

from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.studies.paper import computed
from flexfmu.cosim.studies.paper.comparison import TABLES, PrintedTable, Verdict, printed_table, printed_tables
from flexfmu.cosim.studies.paper.computed import curves, profiles, simulated_cases
from flexfmu.cosim.studies.paper.report import source

SHAPES = {
    "table-02": (1, 5),
    "table-05": (1, 12),
    "table-06": (1, 12),
    "frequencies": (1, 6),
    "table-07": (3, 36),
    "table-08": (3, 36),
    "table-09": (3, 36),
    "table-10": (3, 36),
    "table-11": (4, 52),
}
"""Table → number of quantities and of figures, counted in the paper."""


@pytest.fixture(params=TABLES)
def table(request: pytest.FixtureRequest) -> PrintedTable:
    return printed_table(request.param)


def test_no_figure_is_missing(table: PrintedTable) -> None:
    """A cell lost while typing a table would silently shorten every comparison."""
    figures = [figure for quantity in table.quantities for row in quantity.values for figure in row]
    assert (len(table.quantities), len(figures)) == SHAPES[table.key]


def test_figures_fit_rows_and_columns(table: PrintedTable) -> None:
    """Every block has a figure above zero for each row and column."""
    for quantity in table.quantities:
        assert len(quantity.values) == len(quantity.rows)
        assert all(len(row) == len(quantity.columns) for row in quantity.values)
        assert all(float(figure) > 0.0 for row in quantity.values for figure in row)


def test_remarks_name_existing_rows_and_columns(table: PrintedTable) -> None:
    """A remark on a misspelt row would never be shown."""
    for quantity in table.quantities:
        for remark in quantity.remarks:
            assert set(remark.rows) <= set(quantity.rows)
            assert set(remark.columns) <= set(quantity.columns)


def test_metrics_can_be_computed(table: PrintedTable) -> None:
    """Every quantity names something that the package computes."""
    known = {*computed.motion_evaluators(), *METRICS, "natural_frequency"}
    assert {quantity.metric for quantity in table.quantities} <= known


def test_source_is_cited() -> None:
    """Printed figures are never shown without where they come from."""
    assert "Barnard" in source().citation
    assert "ESDA2012-82197" in source().citation


def test_corrupt_tables_are_marked_as_such() -> None:
    """Nobody validates against Tables 8 and 10: only the Lamé positions of Table 10 count as printed."""
    believable = [
        (table.key, quantity.metric, column)
        for table in printed_tables()
        if table.key in ("table-08", "table-10")
        for quantity in table.quantities
        for row in quantity.rows
        for column in quantity.columns
        if not any(r.concerns(row, column) and r.verdict is Verdict.MISPRINT for r in quantity.remarks)
    ]
    assert set(believable) == {("table-10", "end_position_error", "Lamé")}
    assert len(believable) == 4


def test_every_verdict_has_a_sentence() -> None:
    """A reader is told what a verdict means."""
    assert all(verdict.sentence for verdict in Verdict)


def test_simulations_are_the_twelve_combinations_twice_and_the_extended_curves() -> None:
    """Every simulation that the tables need is run, and none twice."""
    cases = simulated_cases(printed_tables())
    assert len(cases) == len(set(cases)) == 12 * 2 + 4 * 2
    assert {profile for _, profile, _ in cases} == set(profiles())
    assert {curve for _, _, curve in cases} == {"Lamé", "Clothoid", "Polar", "Lamé Ext", "Clot. Ext"} <= set(curves())
