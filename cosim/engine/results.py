"""Results of a co-simulation: signals over time, in memory, as files, and in the forms of other tools."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flexfmu.cosim.engine.columns import Column, LazyColumns, SignalTable, chosen
from flexfmu.cosim.engine.errors import InputError, ResultsError, extra, suggestion
from flexfmu.cosim.engine.formats import WRITERS, check_format, read_csv, read_mat, read_parquet, write_csv
from flexfmu.cosim.engine.showing import few_lines, html_table, shown_unit
from flexfmu.cosim.engine.slave import RealArray

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

__all__ = ["EVERYTHING", "FORMATS", "Column", "LazyColumns", "Recording", "Selection", "SignalTable"]

FORMATS = (*WRITERS,)
"""Suffixes of the files that `Recording.write` writes."""

Names = str | Collection[str] | None
"""Names of signals, in which ``*`` stands for any characters; None for all."""


@dataclass(frozen=True, repr=False)
class Recording(Mapping[str, Column]):
    """Signals over time, a mapping from their names. An instant at which signals jump appears twice: left limits first, then right limits.

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

    def __repr__(self) -> str:
        """Return at most five lines: instants, and names of signals."""
        return few_lines(f"{self._head()}:", [*self.columns])

    def _head(self) -> str:
        span = f" from {self.time[0]:g} to {self.time[-1]:g} s" if self.time.size else ""
        return f"Recording of {self.time.size} instants{span}, {len(self.columns)} signals"

    def _repr_html_(self) -> str:
        rows = [(name, shown_unit(column.unit), *_extremes(column)) for name, column in self.columns.items()]
        table = html_table(("signal", "unit", "smallest", "largest"), rows)
        return f"<details><summary>{self._head()}</summary>{table}</details>"

    def __getitem__(self, name: str) -> Column:
        """Return the column of that name; the KeyError lists the recorded signals."""
        try:
            return self.columns[name]
        except KeyError:
            raise KeyError(f"no signal {name!r} was recorded; {suggestion(name, self.columns)}") from None

    def __iter__(self) -> Iterator[str]:
        """Return an iterator over the names of the signals."""
        return iter(self.columns)

    def __len__(self) -> int:
        """Return the number of signals."""
        return len(self.columns)

    def __bool__(self) -> bool:
        """Return True, also without signals: it is a recording."""
        return True

    def __contains__(self, name: object) -> bool:
        """Return whether a signal of that name was recorded."""
        return name in self.columns

    @property
    def units(self) -> dict[str, str]:
        """Name → unit of the time and of every signal."""
        return {"time": "s", **{name: column.unit for name, column in self.columns.items()}}

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

    def to_pandas(self, names: Names = None) -> pandas.DataFrame:
        """Return signals as a data frame with the index ``time`` [s], and their units in ``frame.attrs["units"]``.

        Args:
            names: names of the signals, in which ``*`` stands for any characters (``joint*.torque``); None for all.

        Raises:
            InputError: a signal doesn't exist, or pandas isn't installed (``pip install "flexfmu[pandas]"``).
        """
        columns = chosen(self.columns, names)
        with extra("pandas"):
            import pandas
        listed = {name: column.listed() for name, column in columns.items()}
        frame = pandas.DataFrame(listed, index=pandas.Index(self.time, name="time"))
        frame.attrs["units"] = {"time": "s", **{name: column.unit for name, column in columns.items()}}
        return frame

    def to_xarray(self, names: Names = None) -> xarray.Dataset:
        """Return signals as a data set with the coordinate ``time`` [s]; each has its unit as ``attrs["units"]``.

        Arguments and errors: as for `to_pandas`; ``pip install "flexfmu[xarray]"``.
        """
        columns = chosen(self.columns, names)
        with extra("xarray"):
            import xarray
        variables = {name: ("time", column.listed(), {"units": column.unit}) for name, column in columns.items()}
        return xarray.Dataset(variables, coords={"time": ("time", self.time, {"units": "s"})})

    def plot(self, names: Names = None, title: str = "") -> Figure:
        """Return a Matplotlib figure of signals over time, a pair of axes for each unit.

        Notebooks show it; elsewhere ``figure.savefig("plot.png")`` writes it.

        Args:
            names: as for `to_pandas`; None for torques, end-effector positions and tip deflections, or for all if there
                are none of these.
            title: heading.

        Raises:
            InputError: a signal doesn't exist.
        """
        usual = [name for name in USUAL if name in self.columns] if names is None else names
        columns = {name: each for name, each in chosen(self.columns, usual or None).items() if each.texts is None}
        from flexfmu.cosim.engine.drawing import draw_signals

        return draw_signals(self.time, columns, title)

    def write(self, path: str | os.PathLike[str], about: Mapping[str, str] | None = None) -> Path:
        """Write time and values (not the derivatives) in the format that the suffix says; return the path.

        ``.csv``: see `write_csv`, without units. ``.parquet``: units in the fields' metadata. ``.mat``: for MATLAB, with the
        structs ``names`` and ``units``. ``.mcap``: for Foxglove and PlotJuggler, with log times from simulation time.

        Args:
            path: of the file, which is written atomically.
            about: key → text for the metadata of the file; CSV files have none.

        Raises:
            InputError: there is no such format, or its library isn't installed (``pip install "flexfmu[parquet]"``, for example).
            ResultsError: the file can't be written, with the system's reason.
        """
        target = Path(path)
        return check_format(target.suffix.removeprefix("."))(target, self.time, self.columns, about or {})

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Recording:
        """Read a ``.csv``, ``.parquet`` or ``.mat`` file by `write`; it has no derivatives, and in CSV no units.

        Raises:
            InputError: there is no such format, or its library isn't installed.
            ResultsError: the file can't be read, or isn't a table of signals.
        """
        source = Path(path)
        if source.suffix == ".csv":
            return cls.read_csv(source)
        if source.suffix == ".parquet":
            check_format("parquet")
            return cls(*read_parquet(source))
        if source.suffix == ".mat":
            return cls(*read_mat(source))
        raise InputError(f"can't read {source}: results are read from .csv, .parquet and .mat files")

    def write_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write time and values (not the derivatives) in the format of `fmpy.util.read_csv`; return the path.

        Names are quoted, ``time`` comes first, and numbers are the shortest that read back exactly. fmpy splits the
        header at every comma, so ``der(x,2)`` is written as ``der(x;2)``. Texts are quoted with doubled quotes inside
        (RFC 4180); fmpy can't read columns of texts. The file is written atomically.

        `fmpy.util.plot_result` needs plotly (the extra ``plot``). It can plot at most 17 columns, given by ``names``: without
        names it takes the first 19, and plotly refuses so many rows at fmpy's spacing (fmpy 0.3.32).

        Raises:
            ResultsError: the file can't be written, with the system's reason.
        """
        return write_csv(Path(path), self.time, self.columns)

    @classmethod
    def read_csv(cls, path: str | os.PathLike[str]) -> Recording:
        """Read a file written by `write_csv` or fmpy; it has neither units nor derivatives.

        Raises:
            ResultsError: the file can't be read, or isn't a table of signals.
        """
        return cls(*read_csv(Path(path)))


USUAL = (
    "joint1.torque",
    "joint2.torque",
    "end_effector.position.x",
    "end_effector.position.y",
    "link11.tip_deflection",
    "link21.tip_deflection",
)
"""Signals that `Recording.plot` shows by default."""


def _extremes(column: Column) -> tuple[str, str]:
    """Return smallest and largest finite value as texts; empty if there is none."""
    known = column.values[np.isfinite(column.values)]
    if column.texts is not None or not known.size:
        return "", ""
    return f"{known.min():.6g}", f"{known.max():.6g}"


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
                raise InputError(f"there is no signal {name!r} to record; {suggestion(name, known)}")


EVERYTHING = Selection()
