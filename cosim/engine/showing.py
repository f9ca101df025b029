"""Objects as a user sees them: a few lines on a terminal, a table in a notebook, a data frame; and the progress of what takes long."""

from __future__ import annotations

import csv
import re
from abc import ABC, abstractmethod
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import BytesIO, StringIO
from math import pi
from textwrap import wrap
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic_core import to_json

from flexfmu.cosim.engine.errors import extra

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

ShowProgress = Callable[[str, float | None], None]
"""Called with the current activity and the finished fraction, 0..1; None where it isn't known."""


def quiet(text: str, fraction: float | None) -> None:
    """Show no progress."""


WIDTH = 79
"""Columns of a line; the narrowest terminals have 80."""

PIXELS = 90
"""Of a picture in a notebook, for an inch."""


def few_lines(head: str, items: Sequence[str], lines: int = 4) -> str:
    """Return a line and below it the items in at most this many lines; where not all fit, the last line counts the others."""
    if not items:
        return shorten(head, WIDTH)
    # no line has more items than this
    shown = min(len(items), lines * WIDTH // 3)
    while True:
        rest = "" if shown == len(items) else f", … {len(items) - shown} more"
        # spaces within an item don't break it
        text = ", ".join(item.replace(" ", "\0") for item in items[:shown]) + rest
        found = wrap(
            text, WIDTH, initial_indent="  ", subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        )
        if len(found) <= lines or shown == 1:
            return "\n".join([shorten(head, WIDTH), *found]).replace("\0", " ")
        shown -= 1


def shorten(text: str, most: int) -> str:
    """Return a text in one line of at most this many characters; what is cut off is an ellipsis."""
    line = " ".join(text.split())
    return line if len(line) <= most else line[: most - 1].rstrip() + "…"


UNITS: Mapping[str, tuple[str, float]] = {
    name: (unit, factor)
    for unit, factors in {
        "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0},
        "m": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6},
        "m/s": {"m/s": 1.0, "mm/s": 1e-3},
        "m/s2": {"m/s2": 1.0, "m/s²": 1.0, "m/s^2": 1.0, "g": 9.80665},
        "rad": {"rad": 1.0, "mrad": 1e-3, "deg": pi / 180.0, "°": pi / 180.0},
        "rad/s": {"rad/s": 1.0, "deg/s": pi / 180.0, "°/s": pi / 180.0, "rpm": pi / 30.0, "1/min": pi / 30.0},
        "rad/s2": {"rad/s2": 1.0, "rad/s²": 1.0, "deg/s2": pi / 180.0},
        "N": {"N": 1.0, "kN": 1e3},
        "N.m": {
            **dict.fromkeys(("N.m", "N·m", "Nm", "N*m"), 1.0),
            **dict.fromkeys(("mN.m", "mN·m", "mNm"), 1e-3),
            **dict.fromkeys(("kN.m", "kN·m", "kNm"), 1e3),
        },
        "W": {"W": 1.0, "kW": 1e3},
        "J": {"J": 1.0, "kJ": 1e3},
    }.items()
    for name, factor in factors.items()
}
"""Unit as people write it in conditions and in logs → SI unit as files have it, and factor to that."""

SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def shown_unit(unit: str) -> str:
    """Return a unit as people read it, from its name in files: ``N·m`` of ``N.m``, ``m/s²`` of ``m/s2``, nothing of ``1``."""
    powers = re.sub(r"(?<=[a-zA-Z])\d+", lambda digits: digits[0].translate(SUPERSCRIPTS), unit.replace(".", "·"))
    return "" if unit == "1" else powers


def html_picture(figure: Figure) -> str:
    """Return a figure as an image in HTML."""
    content = BytesIO()
    figure.savefig(content, format="png", dpi=PIXELS)
    return f'<img alt="" style="max-width: 100%" src="data:image/png;base64,{b64encode(content.getvalue()).decode()}">'


def html_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in HTML for a notebook; all cells are texts."""
    from html import escape

    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


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
        from html import escape

        return f"<pre>{escape(repr(self))}</pre>{self.html_tables()}{html_picture(self.plot())}"

    def to_csv(self) -> str:
        """The rows as CSV, with a line of names."""
        return csv_text(self.rows())


_LIKE_FORMULA, _APOSTROPHE = re.compile(r"^(?='*[=+\-@])"), re.compile(r"^'(?='*[=+\-@])")


def safe_cell(text: str) -> str:
    """A cell of a CSV file: what a spreadsheet would run as a formula begins with an apostrophe; numbers stay as they are."""
    try:
        float(text)
    except ValueError:
        return _LIKE_FORMULA.sub("'", text)
    return text


def cell_text(cell: str) -> str:
    """The text of which `safe_cell` has made a cell."""
    return _APOSTROPHE.sub("", cell)


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of the same names as CSV, with a line of names."""
    text = StringIO()
    writer, names = csv.writer(text, lineterminator="\n"), [*rows[0]]
    for cells in (names, *([row[name] for name in names] for row in rows)):
        writer.writerow([safe_cell(each) if isinstance(each, str) else each for each in cells])
    return text.getvalue()


def _cell(value: Any) -> str:
    """A value of a row, rounded."""
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
