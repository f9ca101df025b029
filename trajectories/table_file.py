"""Motions and single signals from CSV files.

One header line names the columns, in SI units; a unit in brackets may follow a name, as in ``x [m]``. Other columns are ignored,
lines that begin with # too. Columns are separated by commas, semicolons or tabs.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from flexfmu.errors import read_text
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import Coordinates
from flexfmu.trajectories.table import COLUMNS, UNITS, MotionTable

_KINDS = ("position", "velocity", "acceleration")
MEASURED = re.compile(r"joint[12]\.\w+")
"""Signals of results that are measured, not references."""

_HEADER = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]")
"""A column's name and its unit in brackets."""

ALIASES: Mapping[str, str] = {
    "t": "time",
    **{
        f"end_effector.{kind}.{axis}": COLUMNS["end-effector"][order]["xy".index(axis)]
        for order, kind in enumerate(_KINDS)
        for axis in "xy"
    },
    **{
        f"joint{joint}.{reference}{kind}": COLUMNS["joints"][order][joint - 1]
        for order, kind in enumerate(_KINDS)
        for joint in (1, 2)
        for reference in ("", "reference.")
    },
}
"""Names of results → names of columns."""

_UNITS = {"time": "s"} | {
    name: UNITS[coordinates] + ("", "/s", "/s2", "/s3")[order]
    for coordinates, pairs in COLUMNS.items()
    for order, pair in enumerate(pairs)
    for name in pair
}
"""Column → unit."""

REST = 1e-6
"""Largest speed at start and end, relative to the largest speed of the motion, that counts as rest."""

ESTIMATED_REST = 0.25
"""The same where positions alone are given, and the parabola through the first or last three tells the speed; a motion that
begins at rest has a much smaller one, or rows so far apart that they say little."""

SAME = 1e-9
"""Difference of positions and of velocities before and after a jump, relative to the largest one, that counts as rounding."""

FEWEST = 8
"""Fewest rows of positions from which the speed at start and end is estimated."""


def read_table(path: str | Path, coordinates: Coordinates | None = None) -> MotionTable:
    """Read a motion from a CSV file; see the top of this module.

    Args:
        path: the file.
        coordinates: what to read if the file has both; None for what it has.

    Raises:
        TrajectoryError: the file can't be read, a column is missing, or a value is invalid; the message names file, line,
            column and value.
    """
    file = Path(path)
    try:
        status = file.stat()
        return _read(file, coordinates, status.st_mtime_ns, status.st_size)
    except OSError as error:
        raise TrajectoryError(f"cannot read the motion {file}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise TrajectoryError(f"cannot read the motion {file}: it is not UTF-8 text") from None
    except csv.Error as error:
        raise TrajectoryError(f"cannot read the motion {file}: {error}") from None


@lru_cache(maxsize=32)
def _read(file: Path, coordinates: Coordinates | None, changed: int, size: int) -> MotionTable:
    """The table of a file, cached as long as the file isn't changed."""
    rows = _rows(read_text(file))
    line, header = next(rows, (1, []))
    where = f"{file}, line {line}"
    names = [_column(name, _UNITS, where) for name in header]
    if any(".reference." in each for each in header):
        # measured angles beside the references are what came of them
        names = [
            "" if MEASURED.fullmatch(each.partition(" ")[0]) else name for each, name in zip(header, names, strict=True)
        ]
    chosen = _chosen(names, coordinates, where)
    columns = ("time", *(name for pair in COLUMNS[chosen] for name in pair if name in names))
    places = [(name, names.index(name)) for name in columns]
    lines, values = _numbers(file, rows, len(names), places)
    if len({row[0] for row in values}) < 2:
        raise TrajectoryError(
            f"{file}: a motion needs 2 or more rows of different times, got {min(len(values), 1)}; add rows below the header"
        )
    data = np.array(values)
    # two rows at start or end are a jump from or to rest: the outer one goes
    kept = slice(int(data[0, 0] == data[1, 0]), len(data) - int(data[-1, 0] == data[-2, 0]))
    own, lines = data[kept, 0], lines[kept]
    derivatives = np.ascontiguousarray(data[kept, 1:].reshape(len(own), -1, 2).swapaxes(0, 1))
    _join(str(file), chosen, own, derivatives, lines)
    table = MotionTable(str(file), chosen, own - own[0], derivatives, tuple(lines))
    _check_rest(table)
    return table


def read_signal(path: str | Path, column: str, unit: str) -> tuple[RealArray, RealArray]:
    """Read one signal over time from a CSV file; see the top of this module.

    Args:
        path: the file, with a column ``time`` or ``t``.
        column: name of the signal's column.
        unit: its unit, which the header may state; empty for any.

    Returns:
        Times (N,) [s], ascending, and values (N,).

    Raises:
        TrajectoryError: the file can't be read, a column is missing or in another unit, times don't ascend, or a value isn't
            finite; the message names file, line, column and value.
    """
    file = Path(path)
    try:
        text = read_text(file)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise TrajectoryError(f"can't read {file}: {reason}") from None
    rows = _rows(text)
    line, header = next(rows, (1, []))
    where = f"{file}, line {line}"
    names = [_column(each, {"time": "s", column: unit}, where) for each in header]
    for name, wanted in (("time", "s"), (column, unit)):
        if name not in names:
            raise TrajectoryError(f"{where}: there is no column {name} [{wanted}]; columns: {', '.join(header)}")
    lines, found = _numbers(file, rows, len(header), [(name, names.index(name)) for name in ("time", column)])
    if not found:
        raise TrajectoryError(f"{file} has no rows below its header")
    for line, ((before, _), (now, _)) in zip(lines[1:], pairwise(found), strict=True):
        if now <= before:
            raise TrajectoryError(f"{file}, line {line}: {now} s comes after {before} s; times have to ascend")
    times, values = np.array(found).T
    return times, values


def _rows(text: str) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line that is neither empty nor a comment."""
    lines = text.splitlines()
    head = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    delimiter = max(",;\t", key=head.count)
    for number, cells in enumerate(csv.reader(lines, delimiter=delimiter), start=1):
        if any(cell.strip() for cell in cells) and not cells[0].startswith("#"):
            yield number, [cell.strip() for cell in cells]


def _column(header: str, units: Mapping[str, str], where: str) -> str:
    """The name of a column with one of these units; of other columns the header as it is.

    Raises:
        TrajectoryError: the column has another unit.
    """
    if header in units:
        return header
    found = _HEADER.fullmatch(header)
    name = found["name"] if found else header
    name = name if name in units else ALIASES.get(name, name)
    if name not in units:
        return header
    # a unit with powers as plain digits
    unit = found["unit"].strip().replace("^", "").replace("²", "2").replace("³", "3") if found else units[name]
    if units[name] and unit != units[name]:
        raise TrajectoryError(f"{where}: column {name} is in {unit}; convert it to {units[name]}")
    return name


def _chosen(names: Sequence[str], wanted: Coordinates | None, where: str) -> Coordinates:
    """What the positions of a file with these columns are.

    Raises:
        TrajectoryError: a column is missing or given twice, or it isn't clear which to take.
    """
    if "time" not in names:
        raise TrajectoryError(f"{where}: there is no column time [s]; columns: {', '.join(names)}")
    there = [each for each, pairs in COLUMNS.items() if any(name in names for name in pairs[0])]
    if not there or (wanted is not None and wanted not in there):
        needed = " and ".join(COLUMNS[wanted][0]) if wanted else "x and y [m], or q11 and q21 [rad]"
        raise TrajectoryError(f"{where}: there are no columns {needed}; columns: {', '.join(names)}")
    if wanted is None and len(there) > 1:
        raise TrajectoryError(
            f'{where}: x, y and q11, q21 are both there; take one by `coordinates` = "end-effector" or "joints"'
        )
    chosen = wanted or there[0]
    # pairs without gaps, each column once
    highest = max(order for order, pair in enumerate(COLUMNS[chosen]) if any(name in names for name in pair))
    for pair in COLUMNS[chosen][: highest + 1]:
        for name in pair:
            if names.count(name) != 1:
                problem = "is missing" if name not in names else "is there twice"
                raise TrajectoryError(f"{where}: column {name} {problem}; columns: {', '.join(names)}")
    return chosen


def _numbers(
    file: Path, rows: Iterator[tuple[int, list[str]]], count: int, places: Sequence[tuple[str, int]]
) -> tuple[list[int], list[list[float]]]:
    """Number of each row's line, and the values of the named columns at these places among ``count``.

    Raises:
        TrajectoryError: a row has another number of values, or one isn't a finite number.
    """
    lines, values = list[int](), list[list[float]]()
    for line, row in rows:
        if len(row) != count:
            raise TrajectoryError(f"{file}, line {line}: {len(row)} values for {count} columns; give one for each")
        lines.append(line)
        values.append([])
        for name, place in places:
            try:
                value = float(row[place])
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise TrajectoryError(
                    f"{file}, line {line}, column {name}: {row[place]!r} is not a finite number; numbers are written like 0.25 or 1e-3"
                )
            values[-1].append(value)
    return lines, values


def _join(file: str, coordinates: Coordinates, time: RealArray, derivatives: RealArray, lines: Sequence[int]) -> None:
    """Check that times ascend; two rows of one time are a jump, for which positions and velocities are made equal.

    Raises:
        TrajectoryError: times don't ascend, positions or velocities jump, or there is a jump where no acceleration is given.
    """
    steps = np.diff(time)
    for i in np.flatnonzero(steps <= 0.0).tolist():
        where = f"{file}, line {lines[i + 1]}, column"
        if steps[i] < 0.0:
            raise TrajectoryError(f"{where} time: {time[i + 1]} s comes after {time[i]} s; times have to ascend")
        if len(derivatives) < 3:
            raise TrajectoryError(
                f"{where} time: {time[i + 1]} s is there twice; that is a jump of the acceleration, for which accelerations must "
                "be given"
            )
        if i in (0, len(steps) - 1) or steps[i + 1] == 0.0:
            raise TrajectoryError(f"{where} time: {time[i + 1]} s is there more than twice; a jump has two rows")
        for order, pair in enumerate(COLUMNS[coordinates][:2]):
            for axis, name in enumerate(pair):
                before, after = derivatives[order, i : i + 2, axis].tolist()
                if abs(after - before) > SAME * abs(derivatives[order, :, axis]).max():
                    raise TrajectoryError(
                        f"{where} {name}: {after} is another value than {before} at the same time {time[i]} s; only "
                        "accelerations and jerks jump"
                    )
        derivatives[:2, i + 1] = derivatives[:2, i]


def _check_rest(table: MotionTable) -> None:
    """Check that the motion starts and ends at rest, for positions alone by an estimate.

    Raises:
        TrajectoryError: it doesn't.
    """
    time, derivatives, file = table.time, table.derivatives, table.source
    unit = f"{UNITS[table.coordinates]}/s"
    if len(derivatives) > 1:
        speeds, limit, said = derivatives[1], REST, "is"
    elif len(time) >= FEWEST:
        speeds, limit, said = np.gradient(derivatives[0], time, axis=0, edge_order=2), ESTIMATED_REST, "suggests"
    else:
        return
    largest = float(abs(speeds).max())
    for row, place in ((0, "start"), (-1, "end")):
        for axis, speed in enumerate(abs(speeds[row]).tolist()):
            if speed > limit * largest:
                name = COLUMNS[table.coordinates][len(derivatives) > 1][axis]
                raise TrajectoryError(
                    f"{file}, line {table.lines[row]}, column {name}: the motion has to {place} at rest, but {said} "
                    f"{speed:.3g} {unit} there; add rows that speed up from rest and slow down to it"
                )
