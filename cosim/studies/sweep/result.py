"""The result of a sweep: its cases with their metrics, as a table, a data frame, a picture, or a Parquet file."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.rows import Rows
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.metric_table import metric
from flexfmu.cosim.studies.sweep.cases import Cases, changes_of
from flexfmu.cosim.studies.sweep.store import TABLE, signal_file, text_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class SweepResult(Rows, Sequence[dict[str, Any]]):
    """The cases of a sweep with their metrics, in SI units: a sequence of rows, each a dict from key or metric to value.

    Attributes:
        name: of the scene.
        cases: what was varied.
        metrics: names of the metrics.
        values: (N, M) the metrics of each case; NaN where one has no value, or where the case failed.
        messages: number of a failed case → why it failed.
        units: key or metric → unit; empty for none.
        recordings: number of a case → recorded signals, where they are in memory.
        folder: where the results are; None where they are in memory alone.
    """

    row_name = "case"

    name: str
    cases: Cases
    metrics: tuple[str, ...]
    values: RealArray
    messages: Mapping[int, str]
    units: Mapping[str, str]
    recordings: Mapping[int, Recording]
    folder: Path | None = None

    def __len__(self) -> int:
        return len(self.cases)

    def __getitem__(self, number: Any) -> Any:
        """The row of a case: ``case``, the keys, the metrics (`flexfmu.Metric`, None for no value) and ``message``."""
        if isinstance(number, slice):
            return [self[i] for i in range(*number.indices(len(self)))]
        if not -len(self) <= number < len(self):
            raise IndexError(f"the sweep has {len(self)} cases, there is no number {number}")
        found = self._row(number % len(self))
        return found | {name: metric(name, found[name]) for name in self.metrics if found[name] is not None}

    def _row(self, number: int) -> dict[str, Any]:
        """The row of a case with plain numbers."""
        found = [None if value != value else value for value in self.values[number].tolist()]
        return {
            "case": number,
            **dict(zip(self.cases.keys, self.cases[number], strict=True)),
            **dict(zip(self.metrics, found, strict=True)),
            "message": self.messages.get(number, ""),
        }

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self[number] for number in range(len(self)))

    @property
    def failed(self) -> list[dict[str, Any]]:
        """The rows of the cases that failed."""
        return [self[number] for number in sorted(self.messages)]

    def recording(self, number: int) -> Recording:
        """The recorded signals of a case.

        Raises:
            InputError: nothing was recorded of it.
            ResultsError: its file can't be read.
        """
        if number in self.recordings:
            return self.recordings[number]
        if self.folder is None or not signal_file(self.folder, number).exists():
            raise InputError(
                f"nothing was recorded of case {number}: ask for signals by `record`, and see its `message`"
            )
        return Recording.read_csv(signal_file(self.folder, number))

    def rows(self) -> Sequence[dict[str, Any]]:
        """The rows of all cases, with plain numbers."""
        return [self._row(number) for number in range(len(self))]

    def row_columns(self) -> Mapping[str, Any]:
        """Number, keys, metrics (NaN for no value) and message of all cases."""
        return {
            "case": range(len(self)),
            **dict(zip(self.cases.keys, self.columns(), strict=True)),
            **dict(zip(self.metrics, self.values.T, strict=True)),
            "message": [self.messages.get(number, "") for number in range(len(self))],
        }

    def row_units(self) -> Mapping[str, str]:
        """Key or metric → unit."""
        return {name: unit for name, unit in self.units.items() if unit}

    def columns(self) -> list[list[Any]]:
        """The values of each key, one for each case."""
        return [list(each) for each in zip(*(self.cases[number] for number in range(len(self))), strict=True)]

    def plot(self) -> Figure:
        """The metrics over the varied keys: lines for one key, heat maps for two, parallel coordinates for more."""
        from flexfmu.cosim.studies.sweep.picture import draw_sweep

        return draw_sweep(self)

    def summary(self) -> dict[str, dict[str, Any]]:
        """Smallest, median and largest value of each metric, the cases of the extremes with their values, and the number of values."""
        found = {}
        for i, name in enumerate(self.metrics):
            column = self.values[:, i]
            there = np.flatnonzero(~np.isnan(column))
            if not there.size:
                continue
            low, high = (int(there[pick(column[there])]) for pick in (np.argmin, np.argmax))
            found[name] = {
                "unit": self.units.get(name, ""),
                "min": float(column[low]),
                "min_case": low,
                "min_values": changes_of(self.cases, low),
                "median": float(np.median(column[there])),
                "max": float(column[high]),
                "max_case": high,
                "max_values": changes_of(self.cases, high),
                "count": int(there.size),
            }
        return found

    def case_text(self, number: int) -> str:
        """The values of a case, ``payload.mass=3.2, trajectory.duration=0.4``."""
        return ", ".join(f"{key}={_value_text(value)}" for key, value in changes_of(self.cases, number).items())

    def __repr__(self) -> str:
        shown = ", ".join(self.metrics[:3]) + (f" and {len(self.metrics) - 3} more" if len(self.metrics) > 3 else "")
        first = f", first {self.case_text(min(self.messages))}" if self.messages else ""
        return (
            f"Sweep of {self.name}: {len(self)} cases, {len(self.messages)} failed{first}\n"
            f"  varied:  {', '.join(self.cases.keys)}\n"
            f"  metrics: {shown}\n"
            f"  results: {self.folder or 'in memory'}\n"
            f"  see .to_pandas(), .plot(), .failed, .summary(), [number]"
        )


def _value_text(value: Any) -> str:
    """A value of a key in four digits; of a table its kind or name."""
    if isinstance(value, Mapping) and ("kind" in value or "name" in value):
        return str(value.get("kind", value.get("name")))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


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
