"""CSV files of signals in fmpy's format."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from flexfmu.cosim.engine.columns import Column, csv_cells
from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.files import write_pieces
from flexfmu.cosim.engine.slave import RealArray

LINES = 96
"""Number of lines of a CSV file that are written at once: few enough for memory that is used again instead of new pages."""


def write_csv(path: Path, time: RealArray, columns: Mapping[str, Column]) -> Path:
    """Write time and values; see `flexfmu.cosim.engine.results.Recording.write_csv`."""
    names = [_file_name(name) for name in ("time", *columns)]
    head = ",".join(f'"{name}"' for name in names) + "\n"
    return write_pieces(path, itertools.chain([head], _lines([Column("s", time), *columns.values()])))


def _lines(columns: list[Column]) -> Iterator[str]:
    """Yield the lines of the table, some hundred at once."""
    are_numbers = all(each.texts is None and each.values.dtype == np.float64 for each in columns)
    for begin in range(0, columns[0].values.size, LINES):
        piece = slice(begin, begin + LINES)
        # numbers alone in whole lines, texts cell by cell
        if are_numbers:
            yield csv_cells(np.stack([each.values[piece] for each in columns], axis=1)) + "\n"
            continue
        table = [Column(each.unit, each.values[piece], texts=each.texts).shown() for each in columns]
        yield "".join(",".join(row) + "\n" for row in zip(*table, strict=True))


def read_csv(path: Path) -> tuple[RealArray, dict[str, Column]]:
    """Return times (N,) [s] and signals; see `flexfmu.cosim.engine.results.Recording.read_csv`."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            names = [name.strip().strip('"').replace(";", ",") for name in file.readline().split(",")]
            body = file.read()
        # numpy reads tables of numbers alone many times faster
        table, texts, known = (
            _with_texts(body) if '"' in body else (np.loadtxt(body.splitlines(), delimiter=",", ndmin=2), set(), [])
        )
    except (OSError, UnicodeDecodeError, ValueError, csv.Error) as error:
        raise ResultsError(f"can't read {path}: {error}") from error
    if names[0] != "time" or table.shape[1] != len(names):
        raise ResultsError(f"{path} is no table of signals: its first column must be named time")
    columns = {name: Column("", table[:, i], texts=known if i in texts else None) for i, name in enumerate(names) if i}
    return table[:, 0], columns


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
