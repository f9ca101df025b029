"""Tables in narrow and wide terminals: every number is whole, whatever the table."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from rich.table import Column, Table

from flexfmu.cosim.cli.run_summary import _metrics_table as metrics_table
from flexfmu.cosim.cli.scenes import _table as scenes_table
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.reports.comparison import ComparedRun
from flexfmu.cosim.reports.comparison import metrics_table as compare_table
from flexfmu.cosim.reports.modes_table import ModalPose, modes_table
from flexfmu.cosim.reports.terminal import as_terminal_table, titled_table

POSES = [
    ModalPose(i / 10, -0.175, 0.32, -1.2345, 2.3456, (31.25, 98.76, 543.21, 6543.2, 65432.1, 7.0)) for i in range(3)
]
METRIC_VALUES = {name: Metric(1.2345e3) for name in METRICS}
SCENE = {
    "name": "barnard2012-6kg",
    "description": "The robot",
    "payload_mass": 6.0,
    "duration": 0.43,
    "drive": "motion",
}
VARIANTS = [ComparedRun(f"results/variant-{i}", Recording(np.zeros(0), {}), METRIC_VALUES) for i in range(4)]
TABLES = {
    "run": metrics_table("barnard2012-6kg", METRIC_VALUES, dict.fromkeys(METRICS, 1.23e-4)),
    "compare": as_terminal_table(compare_table(VARIANTS)),
    "scenes": scenes_table([SCENE, SCENE | {"payload_mass": 123.456}]),
    "modes": modes_table("barnard2012-6kg", POSES)[0],
}
"""Tables of commands with many digits."""


def printed(table: Any, width: int) -> str:
    """What a terminal of this width shows."""
    console = Console(width=width, file=io.StringIO(), record=True, highlight=False)
    console.print(table)
    return console.export_text()


def numbers(table: Table) -> Iterator[str]:
    """The cells of the columns of numbers, and the words with digits of the others."""
    for column in table.columns:
        for cell in (str(each) for each in column.cells):
            yield from [cell] if column.justify == "right" else re.findall(r"\S*\d\S*", cell)


def lost_numbers(table: Table, width: int) -> list[str]:
    """Numbers that can't be read in the printed table."""
    text = printed(table, width)
    assert all(len(line) <= width for line in text.splitlines())
    return [number for number in numbers(table) if number not in text or "…" in text]


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("command", TABLES)
def test_no_number_is_cut_or_broken(command: str, width: int) -> None:
    """Every number of a command's table can be read whole, and no line is longer than the terminal is wide. The same cells in a
    table of rich lack numbers."""
    table = TABLES[command]
    assert len([*numbers(table)]) > 2
    assert lost_numbers(table, width) == []
    plain = Table(*(Column(column.header) for column in table.columns))
    for row in zip(*(column.cells for column in table.columns), strict=True):
        plain.add_row(*row)
    assert width > 60 or command == "scenes" or lost_numbers(plain, width)


def test_drawn_tables_fit_every_width() -> None:
    """Whatever the columns, texts of up to twenty words or numbers, and the width: numbers are whole, lines fit, and a table that
    fits is one table."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        shape = [int(rng.integers(1, 12)), *(int(each) for each in rng.choice([0, 0, 0, 1, 20], rng.integers(1, 12)))]
        heads = [Column(f"heading of {i}", justify="right" if words == 0 else "left") for i, words in enumerate(shape)]
        table = titled_table("A title that is longer than the table below it is wide", *heads)
        for row in range(4):
            texts = [" ".join("abcdefghi"[: rng.integers(1, 9)] for _ in range(words)) for words in shape]
            cells = (text or f"{rng.normal() * 10.0 ** rng.integers(-9, 9):.6g} µm" for text in texts)
            table.add_row(*cells, style="bold" * (row == 1))
        assert lost_numbers(table, int(rng.integers(40, 200))) == []
        wide = printed(table, 2000)
        assert wide.count("─\n") + wide.count("─ \n") == 1


def test_rows_that_do_not_fit_are_blocks() -> None:
    """Each names its row, and has every column once, on a line of its own."""
    table = titled_table("T", "name", numbers=[f"h{i}" for i in range(10)])
    for name in ("first", "second"):
        table.add_row(name, *(f"{name[0]}{i}-123456789" for i in range(10)))
    assert printed(table, 60).split("\n")[:4] == ["T", "first", "  h0: f0-123456789", "  h1: f1-123456789"]
    assert printed(table, 60).count("h9") == 2
    assert "name" in printed(table, 200)


def test_brackets_in_titles_headings_and_cells_are_units() -> None:
    """rich would take "[m]" for markup."""
    table = titled_table("Scene [m]", "x [m]")
    table.add_row("1 [s]")
    assert printed(table, 80).split() == ["Scene", "[m]", "x", "[m]", "─" * 5, "1", "[s]"]
