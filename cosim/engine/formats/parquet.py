"""Parquet files of signals, by pyarrow: the unit of a column is ``unit`` in the metadata of its field."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow
from pyarrow import parquet

from flexfmu.cosim.engine.columns import TWICE, Column, coded
from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.files import replacing
from flexfmu.cosim.engine.slave import RealArray


def write_parquet(path: Path, time: RealArray, columns: Mapping[str, Column], about: Mapping[str, str]) -> Path:
    """Write signals as columns after ``time``, and return the path.

    Args:
        path: of the file.
        time: (N,) instants [s].
        columns: name → signal; signals of type String become columns of texts.
        about: key → text for the metadata of the file, which says what instants that appear twice mean, too.

    Raises:
        ResultsError: the file can't be written, with the system's reason.
    """
    every = {"time": Column("s", time), **columns}
    fields = [
        pyarrow.field(
            name, pyarrow.float64() if column.texts is None else pyarrow.string(), metadata={"unit": column.unit}
        )
        for name, column in every.items()
    ]
    schema = pyarrow.schema(fields, metadata={**about, "jumps": TWICE})
    table = pyarrow.table([pyarrow.array(column.listed()) for column in every.values()], schema=schema)
    # a dictionary pays for texts alone
    texts = [name for name, column in columns.items() if column.texts is not None]
    with replacing(path) as temporary:
        parquet.write_table(table, temporary, use_dictionary=texts or False)
    return path


def read_parquet(path: Path) -> tuple[RealArray, dict[str, Column]]:
    """Return times (N,) [s] and signals of a Parquet file; a file of other programs may lack the units.

    Raises:
        ResultsError: the file can't be read, has no column ``time``, or a column is of neither numbers nor texts.
    """
    try:
        table = parquet.read_table(path)
        names = table.column_names
        if "time" not in names:
            raise ResultsError(f"{path} is no table of signals: it has no column `time`; columns: {', '.join(names)}")
        columns = {name: _column(table.schema.field(name), table.column(name)) for name in names}
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise ResultsError(f"can't read {path}: {' '.join(str(error).split())}") from error
    return columns.pop("time").values, columns


def _column(field: pyarrow.Field, values: pyarrow.ChunkedArray) -> Column:
    unit = (field.metadata or {}).get(b"unit", b"").decode()
    if pyarrow.types.is_string(field.type) or pyarrow.types.is_large_string(field.type):
        return coded(unit, values.to_pylist())
    return Column(unit, values.to_numpy().astype(np.float64))
