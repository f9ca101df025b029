"""Results that are rows of figures: as a data frame, and as CSV."""

from __future__ import annotations

import csv
from abc import abstractmethod
from io import StringIO
from typing import TYPE_CHECKING, Any, ClassVar

from flexfmu.cosim.engine.errors import extra

if TYPE_CHECKING:
    import pandas


class Rows:
    """What a result with rows has in common with all others.

    Attributes:
        index: name of the rows' key that is the data frame's index; None for numbers from 0.
    """

    index: ClassVar[str | None] = None

    @abstractmethod
    def rows(self) -> list[dict[str, Any]]:
        """The rows: name of a figure → its value; all have the same names."""

    def to_pandas(self) -> pandas.DataFrame:
        """The rows as a data frame.

        Raises:
            InputError: pandas isn't installed.
        """
        with extra("pandas"):
            import pandas
        frame = pandas.DataFrame(self.rows())
        return frame if self.index is None else frame.set_index(self.index)

    def to_csv(self) -> str:
        """The rows as CSV, with a line of names."""
        return csv_text(self.rows())


def csv_text(rows: list[dict[str, Any]]) -> str:
    """Return rows of the same names as CSV, with a line of names."""
    text = StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
