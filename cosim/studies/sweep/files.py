"""Files of a finished sweep beside its CSV table: Parquet, if pyarrow is installed, and the picture."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any

from flexfmu.cosim.studies.sweep.result import SweepResult
from flexfmu.cosim.studies.sweep.store import TABLE, text_of

GROUP = 10_000
"""Rows of a Parquet file that are in memory at the same time."""


def write_files(result: SweepResult, folder: Path, *, plot: bool) -> list[Path]:
    """Write Parquet and picture; returns the files of the sweep.

    Args:
        result: the finished sweep.
        folder: where its table is.
        plot: whether a picture is drawn.
    """
    files = [folder / TABLE]
    with contextlib.suppress(ImportError):
        files.append(write_parquet(result, folder / "sweep.parquet"))
    if plot:
        from flexfmu.cosim.reports.figure_style import save, style

        figure = result.plot()
        with style():
            save(figure, folder / "sweep")
        files += [folder / "sweep.png", folder / "sweep.svg"]
    return files


def write_parquet(result: SweepResult, path: Path) -> Path:
    """Write a Parquet table with a column for each key and metric, whose metadata has the unit; atomically.

    Raises:
        ImportError: pyarrow isn't installed.
    """
    import pyarrow
    from pyarrow import parquet

    keys = result.cases.keys
    columns = [_typed(column) for column in result.columns()]
    kinds = {int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_(), str: pyarrow.string()}
    types = [kinds[kind] for kind, _ in columns]
    fields = [pyarrow.field("case", pyarrow.int64())]
    for name, kind in [*zip(keys, types, strict=True), *((name, pyarrow.float64()) for name in result.metrics)]:
        unit = result.units.get(name, "")
        fields.append(pyarrow.field(name, kind, metadata={"unit": unit} if unit else None))
    schema = pyarrow.schema([*fields, pyarrow.field("message", pyarrow.string())])
    schema = schema.with_metadata({"flexfmu": json.dumps({"scene": result.name, "units": dict(result.units)})})
    # some thousand rows after the other
    temporary = path.parent / f".{path.name}.{os.getpid()}"
    try:
        with parquet.ParquetWriter(temporary, schema) as writer:
            for first in range(0, len(result), GROUP):
                part = slice(first, min(first + GROUP, len(result)))
                numbers = range(part.start, part.stop)
                arrays: list[Any] = [pyarrow.array(numbers, pyarrow.int64())]
                arrays += [pyarrow.array(values[part], kind) for (_, values), kind in zip(columns, types, strict=True)]
                arrays += [pyarrow.array(result.values[part, i], from_pandas=True) for i in range(len(result.metrics))]
                arrays.append(pyarrow.array([result.messages.get(number, "") for number in numbers]))
                writer.write_table(pyarrow.table(arrays, schema=schema))
        return temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _typed(values: list[Any]) -> tuple[type, list[Any]]:
    """The type of a column, and its values: numbers and truth values as they are, the rest as text; None for none."""
    there = {type(each) for each in values if each is not None}
    for kind in (bool, int):
        if there == {kind}:
            return kind, values
    if there <= {int, float}:
        return float, [None if each is None else float(each) for each in values]
    return str, [None if each is None else text_of(each) for each in values]
