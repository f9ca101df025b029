"""Motions as tables: rows of times and positions of the end effector or of the joints, with or without derivatives.

They, and single signals, are read from CSV files. One header line names the columns, in SI units; a unit in brackets may follow a
name, as in ``x [m]``. Other columns are ignored, lines that begin with # too. Columns are separated by commas, semicolons or tabs.

Smoothing splines through measured positions: they pass the rows at a distance of the noise, with few knots of their own.

Source: P. Dierckx, *Curve and Surface Fitting with Splines*, Oxford 1993, chapter 5: knots are added until the sum of squared
distances is that of the noise. scipy's `splrep` is its program FITPACK.
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

from flexfmu.errors import read_text, replacing
from flexfmu.trajectories.curves import Point
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import Coordinates, PiecewisePolynomial, listed_degrees, spline
from flexfmu.trajectories.trajectory import Trajectory, limits

DEGREES = (3, 5)
"""Degrees of smoothing splines."""

STANDSTILL = 0.2
"""Rows of standstill before and after the motion, relative to its own rows: they make the spline begin and end at rest."""


def smoothed(
    time: RealArray, positions: RealArray, noise: float, degree: int = 5, coordinates: Coordinates = "end-effector"
) -> PiecewisePolynomial:
    """Return the smoothing spline; it begins and ends at rest at the first and the last position.

    Args:
        time: times [s], ascending from 0, shape (N,).
        positions: measured positions (N, 2).
        noise: standard deviation of their errors, in their unit.
        degree: 3 or 5; the spline is ``degree`` - 1 times continuously differentiable, next to both ends half as often.
        coordinates: what moves.

    Raises:
        TrajectoryError: the degree is another, or there is no such spline.
    """
    from scipy.interpolate import splev, splrep  # here, since other motions need no scipy

    if degree not in DEGREES:
        raise TrajectoryError(f"a smoothing spline (`noise`) has degree 3 or 5, got {degree}")
    # standstill before and after
    count, step = int(np.ceil(STANDSTILL * len(time))) + degree, float(np.median(np.diff(time)))
    still = step * np.arange(1, count + 1)
    longer = np.concatenate([-still[::-1], time, time[-1] + still])
    splines = []
    for axis in positions.T:
        values = np.concatenate([np.full(count, axis[0]), axis, np.full(count, axis[-1])])
        found, _, flag, message = splrep(
            longer, values, w=np.full(len(longer), 1.0 / noise), k=degree, s=len(time), full_output=1, quiet=1
        )
        if flag > 0:
            raise TrajectoryError(f"no smoothing spline for `noise` = {noise:g}: {message}; give another value")
        splines.append(found)
    # the same spline by its derivatives at the knots of both axes, and rest at the ends
    inner = np.unique(np.concatenate([knots for knots, _, _ in splines]))
    apart = 1e-3 * step
    knots = np.concatenate([[0.0], inner[(inner > apart) & (inner < time[-1] - apart)], time[-1:]])
    values = np.stack([[splev(knots, each, k) for k in range(degree // 2 + 1)] for each in splines], axis=-1)
    values[0, [0, -1]], values[1:, [0, -1]] = positions[[0, -1]], 0.0
    return spline(knots, values, degree, coordinates)


COLUMNS: Mapping[Coordinates, tuple[tuple[str, str], ...]] = {
    "end-effector": (("x", "y"), ("vx", "vy"), ("ax", "ay"), ("jx", "jy")),
    "joints": (("q11", "q21"), ("dq11", "dq21"), ("ddq11", "ddq21"), ("dddq11", "dddq21")),
}
"""Coordinates → names of the columns of position, velocity, acceleration and jerk."""

UNITS: Mapping[Coordinates, str] = {"end-effector": "m", "joints": "rad"}
"""Coordinates → unit of the positions."""

JERK = 3
"""Highest derivative of a table."""

ROUNDING = 1e-9
"""Jump of acceleration or jerk, relative to the largest one at any breakpoint, below which one row is written."""

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

    def degree(self, wanted: int | None = None, noise: float | None = None) -> int:
        """Return the degree of the spline: the wanted one, or the default.

        Raises:
            TrajectoryError: it is too low for the derivatives that are given, or these are to be smoothed.
        """
        highest = len(self.derivatives) - 1
        if noise is not None and highest > 0:
            given = ", ".join(name for pair in COLUMNS[self.coordinates][1 : highest + 1] for name in pair)
            raise TrajectoryError(f"`noise` smooths positions, but {self.source} has {given}: remove these columns")
        if noise is not None and wanted == 7:
            raise TrajectoryError("`noise` needs `degree` = 3 or 5, got 7")
        degree = max(DEFAULT_DEGREE, 2 * highest + 1) if wanted is None else wanted
        if degree < 2 * highest + 1:
            raise TrajectoryError(
                f"{self.source} gives derivatives up to order {highest}, which need `degree` = {listed_degrees(highest)}, "
                f"got {degree}: remove columns or take another degree"
            )
        return degree

    def description(self, degree: int | None = None, noise: float | None = None) -> str:
        """Return what the motion is, in a few words: degree and continuity of the spline, rows and file."""
        chosen, order = self.degree(degree), len(self.derivatives) - 1
        given = "positions" + ("", ", velocities", " ... accelerations", " ... jerks")[order]
        moving = self.coordinates.replace("joints", "joint")
        return (
            f"{'' if noise is None else 'smoothing '}spline of degree {chosen} (C{chosen - 1 - order}) through {len(self.time)} rows of {moving} {given} in "
            f"{Path(self.source).name}"
        )

    def trajectory(self, degree: int | None = None, noise: float | None = None) -> PiecewisePolynomial:
        """Return the spline through the rows; see `flexfmu.trajectories.piecewise.spline`.

        Args:
            degree: 3, 5 or 7; None for 5, with jerks for 7.
            noise: standard deviation of measured positions' errors [m or rad], for a smoothing spline of degree 3 or 5; see
                `flexfmu.trajectories.table`.

        Raises:
            TrajectoryError: the degree is too low, or derivatives are to be smoothed.
        """
        if noise is not None:
            return smoothed(self.time, self.derivatives[0], noise, self.degree(degree, noise), self.coordinates)
        return spline(self.time, self.derivatives, self.degree(degree), self.coordinates)


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
            `PiecewisePolynomial` of degree 7 or less, otherwise for 50.

    Raises:
        TrajectoryError: the file can't be written.
    """
    knots, parts = trajectory.breakpoints, rows or 50
    if isinstance(trajectory, PiecewisePolynomial) and trajectory.degree <= 2 * JERK + 1:
        knots, parts = tuple(trajectory.knots.tolist()), rows or 1
    times = np.unique(np.concatenate([np.linspace(a, b, parts + 1) for a, b in pairwise(knots)]))
    # both limits where acceleration or jerk jump, the inner ones at start and end
    inner = np.array(trajectory.breakpoints[1:-1])
    before, after = (limits(trajectory, inner, np.full(inner.shape, left), JERK)[2:] for left in (True, False))
    largest = np.maximum(abs(before), abs(after)).max(axis=(1, 2), initial=0.0, keepdims=True)
    jumps = np.isin(times, inner[(abs(after - before) > ROUNDING * largest).any(axis=(0, 2))])
    instants = np.repeat(times, 1 + jumps)
    left = np.concatenate([[False], np.diff(instants, append=np.inf)[1:] == 0.0])
    left[-1] = True
    values = limits(trajectory, instants, left, JERK)
    # position and velocity don't jump
    second = np.flatnonzero(np.diff(instants) == 0.0) + 1
    values[:2, second] = values[:2, second - 1]
    own: Coordinates = getattr(trajectory, "coordinates", "end-effector")
    moving = own if coordinates is None else coordinates
    header = ["time", *(name for pair in COLUMNS[moving] for name in pair)]
    table = np.column_stack([instants, *(values[order, :, axis] for order in range(JERK + 1) for axis in range(2))])
    lines = [",".join(header), *(",".join(map(repr, row)) for row in table.tolist())]
    try:
        with replacing(Path(path)) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise TrajectoryError(f"cannot write the motion {path}: {error.strerror}") from None


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
