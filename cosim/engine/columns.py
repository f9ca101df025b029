"""Recorded signals: values, derivatives and unit of each, and how they are shown."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from pydantic_core import to_json

from flexfmu.cosim.engine.errors import InputError, ResultsError, suggestion
from flexfmu.cosim.engine.showing import safe_cell, shown_unit
from flexfmu.cosim.engine.slave import RealArray

TWICE = "An instant at which signals jump appears twice: values before the jump first, then those after it."
"""What files of results say about jumps."""


@dataclass(frozen=True, repr=False)
class Column:
    """One recorded signal.

    Attributes:
        unit: unit of the values, for example ``N.m``; empty when unknown.
        values: (N,) values at the recording's times.
        first: (N,) first time derivatives [unit/s]; None if not available.
        second: (N,) second time derivatives [unit/s²]; None if not available.
        texts: for a signal of type String, the texts that its values index; None for numbers.
    """

    unit: str
    values: RealArray
    first: RealArray | None = None
    second: RealArray | None = None
    texts: Sequence[str] | None = None

    def __repr__(self) -> str:
        """Return a line: number of values, unit, range, derivatives."""
        if self.texts is not None:
            return f"Column of {self.values.size} texts"
        known = self.values[np.isfinite(self.values)]
        span = f", {known.min():.6g} to {known.max():.6g}" if known.size else ""
        order = (self.first is not None) + (self.second is not None)
        return f"Column of {self.values.size} values [{shown_unit(self.unit) or '-'}]{span}, {order} derivatives"

    def listed(self) -> RealArray | list[str]:
        """Return the N values, or the N texts of a signal of type String."""
        return self.values if self.texts is None else [self.text_at(i) for i in range(self.values.size)]

    def text_at(self, index: int) -> str:
        """Return the text at the instant ``index``; empty if the value is no index of a text.

        Raises:
            ResultsError: the signal isn't of type String.
        """
        if self.texts is None:
            raise ResultsError("the signal has numbers, no texts; take its `values`")
        code = int(self.values[index])
        return self.texts[code] if 0 <= code < len(self.texts) else ""

    def shown(self) -> list[str]:
        """Return the N values as CSV cells: shortest numbers that read back exactly, or quoted texts (RFC 4180), safe ones."""
        if self.texts is None:
            return [] if self.values.size == 0 else csv_cells(self.values[None]).split(",")
        known = ['"' + safe_cell(text).replace('"', '""') + '"' for text in self.texts]
        return [known[code] if 0 <= code < len(known) else '""' for code in self.values.astype(int).tolist()]


@dataclass(frozen=True)
class SignalTable:
    """Signals as rows of an array.

    Attributes:
        rows: (n, N) values and derivatives at N instants.
        places: name of a signal → unit, and indices of the rows with its value and derivatives.
    """

    rows: RealArray
    places: Mapping[str, tuple[str, range]]

    @classmethod
    def of(cls, columns: Mapping[str, Column]) -> SignalTable:
        """Return these columns as a table."""
        if isinstance(columns, LazyColumns) and columns.table is not None:
            return columns.table
        rows, places = list[RealArray](), {}
        for name, column in columns.items():
            own = [each for each in (column.values, column.first, column.second) if each is not None]
            places[name] = column.unit, range(len(rows), len(rows) + len(own))
            rows += own
        return cls(np.array(rows), places)


class LazyColumns(Mapping[str, Column]):
    """Columns that are made when they are first asked for: making all of them takes longer than short runs should.

    Args:
        names: their names in order.
        make: makes the column of a name; its arrays must have the length of the recording's times.
        table: the array that they come from.

    Attributes:
        table: the array that the columns come from; None if there are others.
    """

    def __init__(self, names: Collection[str], make: Callable[[str], Column], table: SignalTable | None = None) -> None:
        self._names, self._make, self._made = names, make, dict[str, Column]()
        self.table = table

    def __getitem__(self, name: str) -> Column:
        """Return the column of that name."""
        found = self._made.get(name)
        if found is None:
            if name not in self._names:
                raise KeyError(name)
            found = self._made[name] = self._make(name)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __reduce__(self) -> tuple[object, ...]:
        """Copies and pickles have all columns."""
        return dict, (dict(self),)


def coded(unit: str, texts: Iterable[str]) -> Column:
    """Return a signal of type String from its texts at each instant."""
    codes: dict[str, int] = {}
    values = np.array([codes.setdefault(each, len(codes)) for each in texts], dtype=np.float64)
    return Column(unit, values, texts=[*codes])


def chosen(columns: Mapping[str, Column], names: str | Collection[str] | None) -> dict[str, Column]:
    """Return the columns of these names in their order.

    Args:
        columns: name → signal.
        names: names, in which ``*`` stands for any characters (``joint*.torque``); a single one may be a text; None for all.

    Raises:
        InputError: a name isn't among the columns.
    """
    wanted = ["*"] if names is None else [names] if isinstance(names, str) else names
    found: dict[str, Column] = {}
    for name in wanted:
        # brackets belong to names: link11.bending[1]
        these = [name] if name in columns else [each for each in columns if fnmatchcase(each, name.replace("[", "[[]"))]
        if not these and names is not None:
            raise InputError(f"there is no signal {name!r}; {suggestion(name, columns)}")
        found |= {each: columns[each] for each in these}
    return found


def csv_cells(table: RealArray) -> str:
    """Lines of numbers (N, n) with commas between them, the shortest that read back exactly."""
    # the JSON writer of pydantic is ten times faster than `repr`, and writes NaN and Infinity where `repr` writes nan and inf
    text = b"\n".join([to_json(row, inf_nan_mode="constants")[1:-1] for row in table.tolist()]).decode()
    return text if np.isfinite(table).all() else text.replace("NaN", "nan").replace("Infinity", "inf")
