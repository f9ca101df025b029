"""Motions as tables: rows of times and positions of the end effector or of the joints, with or without derivatives.

`flexfmu.trajectories.table_file` reads them from CSV files, `write_table` writes them.

Smoothing splines through measured positions: they pass the rows at a distance of the noise, with few knots of their own.

Source: P. Dierckx, *Curve and Surface Fitting with Splines*, Oxford 1993, chapter 5: knots are added until the sum of squared
distances is that of the noise. scipy's `splrep` is its program FITPACK.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

import numpy as np

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
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise TrajectoryError(f"cannot write the motion {path}: {error.strerror}") from None
