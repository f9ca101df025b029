"""The paper's printed tables as data: `data/*.toml`, read into frozen values."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib.resources import files
from typing import Any

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
    remarks: tuple[Remark, ...]


@dataclass(frozen=True)
class PrintedTable:
    """A table of the paper.

    Attributes:
        key: name of the data file without its suffix.
        label, title: for example ``Table 7`` and its caption.
        scene: name of the shipped scene simulated for it; empty for tables of trajectories alone.
        quantities: the blocks of the table.
        remarks: what holds for the whole table.
    """

    key: str
    label: str
    title: str
    scene: str
    quantities: tuple[PrintedQuantity, ...]
    remarks: tuple[str, ...]


def read_data(name: str) -> dict[str, Any]:
    """Read ``data/<name>.toml`` of this package."""
    return tomllib.loads(
        files("flexfmu.cosim.studies.paper").joinpath("data", f"{name}.toml").read_text(encoding="utf-8")
    )


@cache
def source() -> PaperSource:
    """The paper itself."""
    data = read_data("source")
    return PaperSource(
        authors=tuple(data["authors"]),
        title=data["title"],
        event=data["event"],
        number=data["number"],
        doi=data["doi"],
        url=data["url"],
        remarks=tuple(data["remarks"]),
    )


@cache
def printed_table(key: str) -> PrintedTable:
    """Read one table of `TABLES`."""
    data = read_data(key)
    quantities = []
    for block in data["quantities"]:
        # labels of rows and columns are those of the table unless the block has its own
        rows, columns = block.get("rows", data["rows"]), block.get("columns", data["columns"])
        remarks = tuple(
            Remark(each["text"], Verdict(each["verdict"]), tuple(each.get("rows", ())), tuple(each.get("columns", ())))
            for each in block.get("remarks", ())
        )
        quantities.append(
            PrintedQuantity(
                name=block["name"],
                unit=block["unit"],
                meaning=block["meaning"],
                metric=block["metric"],
                scale=block["scale"],
                rows=tuple(rows),
                columns=tuple(columns),
                values=tuple(tuple(row) for row in block["values"]),
                remarks=remarks,
            )
        )
    return PrintedTable(
        key=key,
        label=data["table"],
        title=data["title"],
        scene=data.get("scene", ""),
        quantities=tuple(quantities),
        remarks=tuple(data.get("remarks", ())),
    )


def printed_tables() -> tuple[PrintedTable, ...]:
    """All tables, in the order of the report."""
    return tuple(printed_table(key) for key in TABLES)
