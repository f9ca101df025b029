"""Motions as tables: CSV files of times and positions of the end effector or of the joints, with or without derivatives.

One header line names the columns, in SI units; a unit in brackets may follow a name, as in ``x [m]``. Other columns are ignored,
lines that begin with # too. Columns are separated by commas, semicolons or tabs.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

import numpy as np

from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import Coordinates, PiecewisePolynomial, listed_degrees, spline
from flexfmu.trajectories.trajectory import Trajectory, limits

COLUMNS: Mapping[Coordinates, tuple[tuple[str, str], ...]] = {
    "end-effector": (("x", "y"), ("vx", "vy"), ("ax", "ay"), ("jx", "jy")),
    "joints": (("q11", "q21"), ("dq11", "dq21"), ("ddq11", "ddq21"), ("dddq11", "dddq21")),
}
"""Coordinates → names of the columns of position, velocity, acceleration and jerk."""

UNITS: Mapping[Coordinates, str] = {"end-effector": "m", "joints": "rad"}
"""Coordinates → unit of the positions."""

_KINDS = ("position", "velocity", "acceleration")
ALIASES: Mapping[str, str] = {
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

REST = 1e-6
"""Largest speed at start and end, relative to the largest speed of the motion, that counts as rest."""

ESTIMATED_REST = 0.25
"""The same where positions alone are given, and the parabola through the first or last three tells the speed; a motion that
begins at rest has a much smaller one, or rows so far apart that they say little."""

DEFAULT_DEGREE = 5
"""Degree of a spline, unless given derivatives need a higher one."""


@dataclass(frozen=True, eq=False)
class MotionTable:
    """Rows of a motion: times and coordinates with or without derivatives.

    Attributes:
        source: name of the file, for messages.
        coordinates: what the positions are.
        time: times from the first row on [s], not descending, shape (N,).
        derivatives: positions [m or rad] and the derivatives that are given, shape (m + 1, N, 2).
        lines: number of each row's line in the file, shape (N,).
    """

    source: str
    coordinates: Coordinates
    time: RealArray
    derivatives: RealArray
    lines: tuple[int, ...]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MotionTable) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of what the motion depends on."""
        data = [self.coordinates.encode(), str(len(self.derivatives)).encode(), self.time, self.derivatives]
        return sha256(b"|".join(bytes(each) for each in data)).hexdigest()

    @property
    def duration(self) -> float:
        """Time from the first to the last row [s]."""
        return float(self.time[-1])

    @property
    def start(self) -> Point:
        """Positions of the first row [m or rad]."""
        first, second = self.derivatives[0, 0].tolist()
        return first, second

    @property
    def largest(self) -> float:
        """Largest absolute value of all positions [m or rad]."""
        return float(abs(self.derivatives[0]).max())

    def degree(self, wanted: int | None = None) -> int:
        """Return the degree of the spline: the wanted one, or the default.

        Raises:
            TrajectoryError: it is too low for the derivatives that are given.
        """
        highest = len(self.derivatives) - 1
        degree = max(DEFAULT_DEGREE, 2 * highest + 1) if wanted is None else wanted
        if degree < 2 * highest + 1:
            raise TrajectoryError(
                f"{self.source} gives derivatives up to order {highest}, which need `degree` = {listed_degrees(highest)}, "
                f"got {degree}: remove columns or take another degree"
            )
        return degree

    def description(self, degree: int | None = None) -> str:
        """Return what the motion is, in a few words: degree and continuity of the spline, rows and file."""
        chosen, order = self.degree(degree), len(self.derivatives) - 1
        given = "positions" + ("", ", velocities", " ... accelerations", " ... jerks")[order]
        moving = self.coordinates.replace("joints", "joint")
        return (
            f"spline of degree {chosen} (C{chosen - 1 - order}) through {len(self.time)} rows of {moving} {given} in "
            f"{Path(self.source).name}"
        )

    def trajectory(self, degree: int | None = None) -> PiecewisePolynomial:
        """Return the spline through the rows; see `flexfmu.trajectories.piecewise.spline`.

        Args:
            degree: 3, 5 or 7; None for 5, with jerks for 7.

        Raises:
            TrajectoryError: the degree is too low.
        """
        return spline(self.time, self.derivatives, self.degree(degree), self.coordinates)


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


@lru_cache(maxsize=32)
def _read(file: Path, coordinates: Coordinates | None, changed: int, size: int) -> MotionTable:
    """The table of a file, cached as long as the file isn't changed."""
    with file.open(encoding="utf-8-sig", newline="") as stream:
        rows = _rows(stream.read())
    line, header = next(rows, (1, []))
    where = f"{file}, line {line}"
    names = [_column(name, where) for name in header]
    chosen = _chosen(names, coordinates, where)
    columns = ("time", *(name for pair in COLUMNS[chosen] for name in pair if name in names))
    places = [(name, names.index(name)) for name in columns]
    # all rows, value by value
    values, lines = list[list[float]](), list[int]()
    for line, row in rows:
        if len(row) != len(names):
            raise TrajectoryError(f"{file}, line {line}: {len(row)} values for {len(names)} columns; give one for each")
        values.append([_number(row[place], f"{file}, line {line}, column {name}") for name, place in places])
        lines.append(line)
    if len(values) < 2:
        raise TrajectoryError(f"{file}: a motion needs 2 or more rows below the header, got {len(values)}")
    data = np.array(values)
    derivatives = np.ascontiguousarray(data[:, 1:].reshape(len(values), -1, 2).swapaxes(0, 1))
    table = MotionTable(str(file), chosen, data[:, 0] - data[0, 0], derivatives, tuple(lines))
    _check_times(table, data[:, 0])
    _check_rest(table)
    return table


def _rows(text: str) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line that is neither empty nor a comment."""
    lines = text.splitlines()
    head = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    delimiter = max(",;\t", key=head.count)
    for number, cells in enumerate(csv.reader(lines, delimiter=delimiter), start=1):
        if any(cell.strip() for cell in cells) and not cells[0].startswith("#"):
            yield number, [cell.strip() for cell in cells]


def _column(header: str, where: str) -> str:
    """The name of a column; of other columns the header as it is.

    Raises:
        TrajectoryError: a known column has another unit.
    """
    found = re.fullmatch(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]", header)
    name, unit = (found["name"], found["unit"].strip()) if found else (header, None)
    name = ALIASES.get(name, name)
    expected = _UNITS.get(name)
    if expected is None:
        return header
    if unit is not None and unit.replace("^", "").replace("²", "2").replace("³", "3") != expected:
        raise TrajectoryError(
            f"{where}: column {name} is in {unit}; convert it to {expected}, all columns are in SI units"
        )
    return name


_UNITS = {"time": "s"} | {
    name: UNITS[coordinates] + ("", "/s", "/s2", "/s3")[order]
    for coordinates, pairs in COLUMNS.items()
    for order, pair in enumerate(pairs)
    for name in pair
}


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


def _number(text: str, where: str) -> float:
    """The number of a cell.

    Raises:
        TrajectoryError: it isn't a finite number.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TrajectoryError(f"{where}: {text!r} is not a finite number; numbers are written like 0.25 or 1e-3")
    return value


def _check_times(table: MotionTable, own: RealArray) -> None:
    """Check that times ascend; two rows of one time are a jump, at which position and velocity are the same.

    Raises:
        TrajectoryError: they don't, or there is a jump where no acceleration is given.
    """
    steps, file = np.diff(own), table.source
    for i in np.flatnonzero(steps <= 0.0).tolist():
        where = f"{file}, line {table.lines[i + 1]}, column time"
        if steps[i] < 0.0:
            raise TrajectoryError(f"{where}: {own[i + 1]} s comes after {own[i]} s; times have to ascend")
        if len(table.derivatives) < 3:
            raise TrajectoryError(
                f"{where}: {own[i + 1]} s is there twice; that is a jump of the acceleration, for which accelerations must be given"
            )
        if i in (0, len(steps) - 1) or steps[i + 1] == 0.0:
            raise TrajectoryError(
                f"{where}: {own[i + 1]} s is one row too many; a jump has two rows, start and end have one"
            )
        for order, pair in enumerate(COLUMNS[table.coordinates][:2]):
            for axis, name in enumerate(pair):
                before, after = table.derivatives[order, i : i + 2, axis]
                if before != after:
                    raise TrajectoryError(
                        f"{file}, line {table.lines[i + 1]}, column {name}: {after} is another value than {before} at the same "
                        f"time {own[i]} s; only accelerations and jerks jump"
                    )


def _check_rest(table: MotionTable) -> None:
    """Check that the motion starts and ends at rest, for positions alone by an estimate.

    Raises:
        TrajectoryError: it doesn't.
    """
    time, derivatives, file = table.time, table.derivatives, table.source
    unit = f"{UNITS[table.coordinates]}/s"
    if len(derivatives) > 1:
        speeds, limit, said = derivatives[1], REST, "is"
    elif len(time) >= MOST_TELLING:
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


MOST_TELLING = 8
"""Fewest rows of positions from which the speed at start and end is estimated."""


def write_table(
    path: str | Path, trajectory: Trajectory, coordinates: Coordinates | None = None, rows: int | None = None
) -> None:
    """Write a motion as a CSV file for ``kind = "table"``: positions, velocities, accelerations and jerks at each knot.

    A spline of degree 7 through these rows is the motion itself if it is a polynomial of at most this degree between its knots.

    Args:
        path: file to write.
        trajectory: the motion.
        coordinates: what moves; None for the trajectory's own ``coordinates``, or the end effector if it has none.
        rows: number of intervals into which each interval between breakpoints is divided; None for one if the motion is a
            `PiecewisePolynomial`, otherwise for 50.

    Raises:
        TrajectoryError: the file can't be written.
    """
    exact = isinstance(trajectory, PiecewisePolynomial)
    knots = trajectory.knots if isinstance(trajectory, PiecewisePolynomial) else np.array(trajectory.breakpoints)
    parts = rows or (1 if exact else 50)
    times = np.unique(np.concatenate([np.linspace(a, b, parts + 1) for a, b in pairwise(knots.tolist())]))
    # both limits at inner breakpoints, the inner ones at start and end
    jumps = np.isin(times, trajectory.breakpoints[1:-1])
    instants = np.repeat(times, 1 + jumps)
    left = np.concatenate([[False], np.diff(instants, append=np.inf)[1:] == 0.0])
    left[-1] = True
    values = limits(trajectory, instants, left, 3)
    # position and velocity don't jump
    after = np.flatnonzero(np.diff(instants) == 0.0) + 1
    values[:2, after] = values[:2, after - 1]
    own: Coordinates = getattr(trajectory, "coordinates", "end-effector")
    moving = own if coordinates is None else coordinates
    header = ["time", *(name for pair in COLUMNS[moving] for name in pair)]
    table = np.column_stack([instants, *(values[order, :, axis] for order in range(4) for axis in range(2))])
    lines = [",".join(header), *(",".join(map(repr, row)) for row in table.tolist())]
    try:
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise TrajectoryError(f"cannot write the motion {path}: {error.strerror}") from None
