"""Results that are rows of figures: as a data frame, as CSV, as JSON, and in notebooks as a table with a picture."""

from __future__ import annotations

import csv
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from html import escape
from io import StringIO
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic_core import to_json

from flexfmu.cosim.engine.errors import extra
from flexfmu.cosim.engine.showing import html_picture, html_table, shown_unit

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

SHOWN = 12
"""Number of rows that a notebook shows."""


class Rows(ABC):
    """What a result with rows has in common with all others: it becomes a data frame, CSV, JSON, and a figure.

    In a notebook it shows its text, a table of rows, and its figure. Nothing is simulated for that.

    Attributes:
        row_name: column that is the data frame's index; empty for numbers from 0.
    """

    row_name: ClassVar[str] = ""

    @abstractmethod
    def plot(self) -> Figure:
        """The figure."""

    @abstractmethod
    def rows(self) -> Sequence[Mapping[str, Any]]:
        """The rows: name of a figure → its value in SI units; all have the same names."""

    def row_columns(self) -> Mapping[str, Any]:
        """Name of a figure → its values, one for each row."""
        rows = self.rows()
        return {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}

    def row_units(self) -> Mapping[str, str]:
        """Name of a figure, or of a row where these are the figures → unit; those without one are left out."""
        return {}

    def to_pandas(self) -> pandas.DataFrame:
        """The rows as a data frame, whose ``attrs["units"]`` has the units.

        Raises:
            InputError: pandas isn't installed.
        """
        with extra("pandas"):
            import pandas
        frame = pandas.DataFrame(self.row_columns())
        frame = frame.set_index(self.row_name) if self.row_name else frame
        frame.attrs["units"] = {**self.row_units()}
        return frame

    def to_json(self) -> str:
        """The rows as JSON; what isn't a number, or is infinite, is null."""
        return to_json([*map(dict, self.rows())], indent=2, inf_nan_mode="null").decode() + "\n"

    def shown_rows(self) -> Sequence[Mapping[str, Any]]:
        """The rows of the table in a notebook, of which it shows the first `SHOWN`."""
        return self.rows()

    def html_tables(self) -> str:
        """The table of a notebook, without columns that are empty."""
        units, rows = self.row_units(), self.shown_rows()
        shown = rows[:SHOWN]
        names = [name for name in (rows[0] if rows else ()) if any(row[name] not in ("", None) for row in shown)]
        header = [f"{name} [{unit}]" if (unit := shown_unit(units.get(name, ""))) else name for name in names]
        table = html_table(header, ([_cell(row[name]) for name in names] for row in shown))
        return f'<div style="overflow-x: auto">{table}</div>' + (
            f"<p>{len(rows) - SHOWN} more</p>" if len(rows) > SHOWN else ""
        )

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>{self.html_tables()}{html_picture(self.plot())}"

    def to_csv(self) -> str:
        """The rows as CSV, with a line of names."""
        return csv_text(self.rows())


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of the same names as CSV, with a line of names."""
    text = StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _cell(value: Any) -> str:
    """A value of a row, rounded."""
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
