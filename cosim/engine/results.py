"""Results of a co-simulation: signals over time, in memory and as CSV files in fmpy's format."""

from __future__ import annotations

import csv
import io
import itertools
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from pydantic_core import to_json

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import write_pieces
from flexfmu.cosim.engine.slave import RealArray

LINES = 96
"""Number of lines of a CSV file that are written at once: few enough for memory that is used again instead of new pages."""


@dataclass(frozen=True)
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
        """Return the N values as CSV cells: shortest numbers that read back exactly, or quoted texts (RFC 4180)."""
        if self.texts is None:
            return [] if self.values.size == 0 else _cells(self.values[None]).split(",")
        known = ['"' + text.replace('"', '""') + '"' for text in self.texts]
        return [known[code] if 0 <= code < len(known) else '""' for code in self.values.astype(int).tolist()]


@dataclass(frozen=True)
class Table:
    """Signals as rows of an array.

    Attributes:
        rows: (n, N) values and derivatives at N instants.
        places: name of a signal → unit, and indices of the rows with its value and derivatives.
    """

    rows: RealArray
    places: Mapping[str, tuple[str, range]]

    @classmethod
    def of(cls, columns: Mapping[str, Column]) -> Table:
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

    def __init__(self, names: Collection[str], make: Callable[[str], Column], table: Table | None = None) -> None:
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


@dataclass(frozen=True)
class Recording:
    """Signals over time. An instant at which signals jump appears twice: left limits first, then right limits.

    Attributes:
        time: (N,) instants [s], not decreasing.
        columns: name of a signal → its values; every array has the length of ``time``.

    Raises:
        ResultsError: a column's length differs from that of ``time``.
    """

    time: RealArray
    columns: Mapping[str, Column]

    def __post_init__(self) -> None:
        shape, columns = self.time.shape, {} if isinstance(self.columns, LazyColumns) else self.columns
        for name, column in columns.items():
            for values in (column.values, column.first, column.second):
                if values is not None and values.shape != shape:
                    raise ResultsError(f"{name!r} has {values.size} values for {self.time.size} instants")

    def __getitem__(self, name: str) -> Column:
        """Return the column of that name; the KeyError lists the recorded signals."""
        try:
            return self.columns[name]
        except KeyError:
            raise KeyError(f"no signal {name!r} was recorded; there are: {', '.join(self.columns)}") from None

    def smooth_pieces(self) -> Iterator[slice]:
        """Yield the index ranges between jumps; within each, time increases strictly and the signals are continuous.

        A range has a single instant if two jumps coincide (before the first motion, for example).
        """
        edges = np.flatnonzero(np.diff(self.time) == 0.0) + 1
        for begin, end in zip((0, *edges), (*edges, self.time.size), strict=True):
            yield slice(int(begin), int(end))

    def with_columns(self, columns: Mapping[str, Column]) -> Recording:
        """Return the recording with further columns."""
        return Recording(self.time, {**self.columns, **columns})

    def only(self, keeps: Callable[[str], bool]) -> Recording:
        """Return the recording with only those signals for whose names ``keeps`` is true."""
        return Recording(self.time, {name: self.columns[name] for name in self.columns if keeps(name)})

    def write_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write time and values (not the derivatives) in the format of `fmpy.util.read_csv`; return the path.

        Names are quoted, ``time`` comes first, and numbers are the shortest that read back exactly. fmpy splits the
        header at every comma, so ``der(x,2)`` is written as ``der(x;2)``. Texts are quoted with doubled quotes inside
        (RFC 4180); fmpy can't read columns of texts. The file is written atomically.

        `fmpy.util.plot_result` can plot at most 17 columns, given by ``names``: without names it takes the first 19,
        and plotly refuses so many rows at fmpy's spacing (fmpy 0.3.32).

        Raises:
            ResultsError: the file can't be written, with the system's reason.
        """
        names = [_file_name(name) for name in ("time", *self.columns)]
        return write_pieces(
            Path(path), itertools.chain([",".join(f'"{name}"' for name in names) + "\n"], self._lines())
        )

    def _lines(self) -> Iterator[str]:
        """Yield the lines of the table, some hundred at once."""
        columns = [Column("s", self.time), *self.columns.values()]
        are_numbers = all(each.texts is None and each.values.dtype == np.float64 for each in columns)
        for begin in range(0, self.time.size, LINES):
            piece = slice(begin, begin + LINES)
            # numbers alone in whole lines, texts cell by cell
            if are_numbers:
                yield _cells(np.stack([each.values[piece] for each in columns], axis=1)) + "\n"
                continue
            table = [Column(each.unit, each.values[piece], texts=each.texts).shown() for each in columns]
            yield "".join(",".join(row) + "\n" for row in zip(*table, strict=True))

    @classmethod
    def read_csv(cls, path: str | os.PathLike[str]) -> Recording:
        """Read a file written by `write_csv` or fmpy; it has neither units nor derivatives.

        Raises:
            ResultsError: the file can't be read, or isn't a table of signals.
        """
        try:
            with open(path, encoding="utf-8", newline="") as file:
                names = [name.strip().strip('"').replace(";", ",") for name in file.readline().split(",")]
                body = file.read()
            # numpy reads tables of numbers alone many times faster
            table, texts, known = (
                _with_texts(body) if '"' in body else (np.loadtxt(body.splitlines(), delimiter=",", ndmin=2), set(), [])
            )
        except (OSError, UnicodeDecodeError, ValueError, csv.Error) as error:
            raise ResultsError(f"can't read {os.fspath(path)}: {error}") from error
        if names[0] != "time" or table.shape[1] != len(names):
            raise ResultsError(f"{os.fspath(path)} is no table of signals: its first column must be named time")
        columns = {
            name: Column("", table[:, i], texts=known if i in texts else None) for i, name in enumerate(names) if i
        }
        return cls(table[:, 0], columns)


def _cells(table: RealArray) -> str:
    """Lines of numbers (N, n) with commas between them, the shortest that read back exactly."""
    # the JSON writer of pydantic is ten times faster than `repr`, and writes NaN and Infinity where `repr` writes nan and inf
    text = b"\n".join([to_json(row, inf_nan_mode="constants")[1:-1] for row in table.tolist()]).decode()
    return text if np.isfinite(table).all() else text.replace("NaN", "nan").replace("Infinity", "inf")


def _with_texts(body: str) -> tuple[RealArray, set[int], list[str]]:
    """Return the table (N, n) with texts replaced by their indices, the columns of texts, and the list of texts."""
    rows = [row for row in csv.reader(io.StringIO(body, newline=""), quoting=csv.QUOTE_NONNUMERIC) if row]
    # the first row tells columns of texts from columns of numbers
    texts = {i for i, cell in enumerate(rows[0]) if isinstance(cell, str)}
    codes: dict[str, int] = {}
    table = [
        [codes.setdefault(cell, len(codes)) if i in texts else float(cell) for i, cell in enumerate(row)]
        for row in rows
    ]
    return np.array(table, dtype=np.float64), texts, [*codes]


def _file_name(name: str) -> str:
    """Return a signal's name as the CSV header has it: commas become semicolons."""
    if any(character in name for character in ';"\n'):
        raise ResultsError(f"the signal name {name!r} has a semicolon, quote or line break; rename it")
    return name.replace(",", ";")


@dataclass(frozen=True)
class Selection:
    """Signals to record, and the order of their derivatives.

    Attributes:
        names: names of the signals to keep, as in the recording; None for all.
        order: highest time derivative to keep, 0 (values alone) to 2; metrics need 2, since they evaluate the
            continuous solution between communication points.
        step: interval of the recorded instants [s], counted from the start; jumps of the references and the end are
            recorded too. None for every communication point.

    Raises:
        InputError: the order isn't 0, 1 or 2, the step isn't positive, or ``names`` is a single text.
    """

    names: Collection[str] | None = None
    order: int = 2
    step: float | None = None

    def __post_init__(self) -> None:
        if self.step is not None and not 0.0 < self.step < np.inf:
            raise InputError(f"the interval of the recorded instants must be above 0 s and finite, got {self.step} s")
        if self.order not in (0, 1, 2):
            raise InputError(f"derivatives are recorded up to order 0, 1 or 2, got {self.order!r}")
        if isinstance(self.names, str):
            raise InputError(f"the signals to record must be a list of names, got the single text {self.names!r}")

    def keeps(self, name: str) -> bool:
        """Return whether a signal is kept."""
        return self.names is None or name in self.names

    def of(self, recording: Recording) -> Recording:
        """Return the recording with only the signals that are kept."""
        return recording if self.names is None else recording.only(self.keeps)

    def check(self, known: Collection[str]) -> None:
        """Check that there are names, and that all are among the known ones.

        Raises:
            InputError: there is none, or a signal doesn't exist.
        """
        if self.names is not None and not self.names:
            raise InputError("the list of signals to record is empty; name one, or None for all")
        for name in self.names or ():
            if name not in known:
                near = get_close_matches(name, known, n=1)
                hint = f"did you mean {near[0]!r}?" if near else f"there are: {', '.join(known)}"
                raise InputError(f"there is no signal {name!r} to record; {hint}")


EVERYTHING = Selection()
