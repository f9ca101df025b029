"""A trajectory as a slave: announces position, velocity and acceleration references as polynomials over each step.

The trajectory may be tabulated, or calculated by an FMU that was exported from one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import factorial
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.hermite import hermite_derivatives
from flexfmu.cosim.engine.slave import COINCIDENT, Indices, RealArray, SlaveVariable
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.trajectory_table import END_ORDER, KINDS, tabulate
from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.trajectory import Trajectory, limits

HERMITE_ORDER = 9
"""Degree of the Hermite polynomial through value and four derivatives at both ends of a step."""

ACCELERATION = len(KINDS) - 1
"""Order of the acceleration; derivatives of this order and higher come from its polynomials."""

TABLE_TOLERANCE = 3e-14
"""Tolerance of tabulated positions, velocities and accelerations, relative to the largest; a third is rounding."""

FEW = 8
"""Largest number of points that are looked up one by one, as step control needs them."""

MANY = 64
"""Number of looked-up points above which the kept ones are discarded."""

KEPT_POINTS = 2**17
"""Number of points of kept tables above which all are discarded; 94 MB."""

ROUNDING = 4.0
"""Bound of rounding errors of times, in units in the last place of the last one."""

REFERENCES = (("position", ""), ("velocity", "/s"), ("acceleration", "/s2"))
"""(reference, suffix of its unit), in the order of the trajectory's derivatives."""


@dataclass(frozen=True)
class PreparedTable:
    """Outputs at communication points (N,) [s]: polynomials of the next steps, and left limits (N, orders, variables)."""

    times: RealArray
    polynomials: RealArray
    ends: RealArray

    def at(self, times: RealArray) -> PreparedTable:
        """The table for the same points some cycles later.

        Lengths of steps differ by the rounding of late times: Hermite polynomials follow to first order, so that they
        reach the left limits at the ends of these steps.
        """
        if self.polynomials.shape[1] <= HERMITE_ORDER:
            return self
        change = np.append(np.diff(times) - np.diff(self.times), 0.0)[:, None, None]
        upper = self._later[:, END_ORDER + 1 :]
        np.multiply(self._slopes, change, out=upper)
        upper += self.polynomials[:, END_ORDER + 1 :]
        return PreparedTable(times, self._later, self.ends)

    @cached_property
    def _later(self) -> RealArray:
        """Polynomials of the later cycle that is current."""
        return self.polynomials.copy()

    @cached_property
    def _slopes(self) -> RealArray:
        """Derivatives of the upper five coefficients by the lengths of the steps, (N, 5, variables).

        At the end of the step the polynomial and its derivatives stay what they are: p(h; h) = d gives dp/dh = -p' there;
        at its beginning dp/dh and its derivatives are zero.
        """
        widths = np.diff(self.times)[:, None]
        # derivatives of orders 1 to 5 at the end
        fifth = sum(self.polynomials[:-1, END_ORDER + 1 + j] * (widths**j / factorial(j)) for j in range(END_ORDER + 1))
        right = -np.concatenate([self.ends[1:, 1:].swapaxes(0, 1), np.asarray(fifth)[None]])
        slopes = np.zeros((self.times.size, END_ORDER + 1, self.ends.shape[2]))
        slopes[:-1] = hermite_derivatives(np.zeros_like(right), right, widths)[END_ORDER + 1 :].swapaxes(0, 1)
        return slopes


class PreparedOutputs:
    """What slaves without inputs have in common whose outputs are known at the prepared communication points.

    Attributes:
        name: name of the slave.
    """

    name: str
    _table: PreparedTable
    _now: RealArray
    _next = 0

    @property
    def announced(self) -> RealArray:
        """Derivatives (N, orders, variables), from order 0, of the polynomials that begin at the prepared points."""
        return self._table.polynomials

    @property
    def ended(self) -> RealArray:
        """Left limits (N, orders, variables), from order 0, at the prepared points."""
        return self._table.ends

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Go to the left limits at the start."""
        self._begin()

    def announce(self, time: float) -> None:
        """Announce the polynomials of the step that begins at ``time`` [s], the next communication point."""
        self._now = self._table.polynomials[self._next]

    def step(self, time: float, step: float) -> None:
        """Go to the left limits at the end of the step."""
        self._next += 1
        self._now = self._table.ends[self._next]

    def set(self, indices: Indices, values: RealArray) -> None:
        """Raise `InputError`: there are no inputs."""
        raise InputError(f"{self.name} has no inputs")

    def get(self, indices: Indices, values: RealArray) -> None:
        """Write current values (n,)."""
        self._now[0].take(indices, None, values, "clip")

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Write current derivatives (orders, n), row k - 1 for order k."""
        self._now[1 : derivatives.shape[0] + 1].take(indices, 1, derivatives, "clip")

    def _begin(self) -> None:
        """Go to the left limits at the first communication point."""
        self._next = 0
        self._now = self._table.ends[0]


class TrajectorySlave(PreparedOutputs):
    """Streams ``<axis>.reference.position``, ``.velocity`` and ``.acceleration`` of a trajectory.

    Over a communication step each reference is a polynomial: for order 9 the Hermite polynomial through value and four
    derivatives at both ends, for orders 0 to 8 the Taylor polynomial of that order, as from a tool that sends fewer
    derivatives. With fixed steps all polynomials are calculated before the run, with both limits at every breakpoint.

    Args:
        trajectory: trajectory to stream; its `evaluate` returns (order + 1, N, axes).
        axes: names of the trajectory's components.
        unit: unit of the positions.
        order: degree of the polynomials, 0 to 9.
        name: name of the slave.

    Attributes:
        trajectory: the streamed trajectory.
        period: period of the trajectory [s], after which it has the same limits, strictly between 0 and its duration; 0 if it doesn't
            repeat.

    Raises:
        InputError: the order isn't 0 to 9.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        axes: Sequence[str] = ("joint1", "joint2"),
        unit: str = "rad",
        order: int = HERMITE_ORDER,
        name: str = "trajectory",
    ) -> None:
        if not 0 <= order <= HERMITE_ORDER:
            raise InputError(f"the order of the reference polynomials must be 0 to {HERMITE_ORDER}, got {order}")
        self.name = name
        self.variables = tuple(
            SlaveVariable(f"{axis}.reference.{kind}", "output", unit + per) for kind, per in REFERENCES for axis in axes
        )
        self.announced_order = order
        self.max_output_order = max(order, END_ORDER)
        self.ends_exactly = order == HERMITE_ORDER
        self.follow(trajectory)

    def follow(self, trajectory: Trajectory) -> None:
        """Stream this trajectory from the next run on."""
        self.trajectory = trajectory
        self.period = float(getattr(trajectory, "period", 0.0))
        self.__dict__.pop("_tabulated", None)
        # the current points; their table and others; the next point, and the current values
        self._times = self._now = np.empty(0)
        self._table = PreparedTable(self._times, self._times, self._times)
        self._tables: list[PreparedTable] = []
        self._next = 0
        self._seen: dict[float, tuple[RealArray, RealArray]] = {}

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Breakpoints of the trajectory [s]."""
        return tuple(self.trajectory.breakpoints)

    @property
    def feedthrough(self) -> dict[str, tuple[str, ...]]:
        """No output depends on an input: there are no inputs."""
        return {variable.name: () for variable in self.variables}

    def prepare(self, times: RealArray) -> None:
        """Calculate the polynomials of all steps between the points (N,) [s]; go to the left limits at the first point.

        If the points are the same as before, at the same place of an earlier cycle, or as many points of standstill
        after the motion, nothing is recalculated.
        """
        known = next((each for each in self._tables if self._holds(each, times)), None)
        if known is None:
            known = self._calculated(times)
            if times.size > FEW:
                if sum(each.times.size for each in self._tables) > KEPT_POINTS:
                    self._tables.clear()
                self._tables.append(known)
        is_same = known.times is times or np.array_equal(known.times, times) or self._rests(times)
        self._table, self._times = known if is_same else known.at(times), times
        self._begin()

    def _holds(self, table: PreparedTable, times: RealArray) -> bool:
        """Whether a table is that of these points, or of the same points some cycles before, but for rounding errors."""
        if table.times is times or table.times.size != times.size:
            return table.times is times
        if self._rests(table.times) and self._rests(times):
            return True
        shift = self.period * round((times[0] - table.times[0]) / self.period) if self.period > 0.0 else 0.0
        # the first cycle has the most exact times; after the last one the motion doesn't begin again
        if shift < 0.0 or (shift > 0.0 and times[-1] >= self.trajectory.duration):
            return False
        rounding = ROUNDING * float(np.spacing(times[-1])) if shift else 0.0
        return bool((abs(times - shift - table.times) <= rounding).all())

    def _rests(self, times: RealArray) -> bool:
        """Whether the points lie after the motion, by more than a step: all references stay what they are."""
        return bool(times[0] - float(np.diff(times).max()) > self.trajectory.duration)

    def _calculated(self, times: RealArray) -> PreparedTable:
        """The polynomials of all steps between these points, and the left limits."""
        near = COINCIDENT * float(np.diff(times).max())
        if times.size <= FEW and self._times.size:
            begins, ends = self._looked_up(times, near)
        else:
            begins, ends = self._limits(self.trajectory, times, near)
        if not self.ends_exactly:
            return PreparedTable(times, begins, ends)
        # Hermite polynomials (N, 10, variables) through the limits at both ends; a Taylor polynomial at the last point
        polynomials = np.zeros((times.size, HERMITE_ORDER + 1, len(self.variables)))
        polynomials[-1, : END_ORDER + 1] = begins[-1]
        beginnings, endings = begins[:-1].swapaxes(0, 1), ends[1:].swapaxes(0, 1)
        polynomials[:-1] = hermite_derivatives(beginnings, endings, np.diff(times)[:, None]).swapaxes(0, 1)
        return PreparedTable(times, polynomials, ends)

    def _looked_up(self, times: RealArray, near: float) -> tuple[RealArray, RealArray]:
        """Return right and left limits at a few points, kept for the next calls: step control repeats points.

        Evaluating the trajectory itself takes as long for one point as for a thousand; hence the table.
        """
        new = [time for time in times.tolist() if time not in self._seen]
        if new:
            if len(self._seen) > MANY:
                self._seen.clear()
                new = times.tolist()
            source = self._tabulated if self.announced_order <= END_ORDER or self.ends_exactly else self.trajectory
            if times.size == 2:
                # step control needs the middle of the step next
                new.append(float(times[0] + 0.5 * (times[1] - times[0])))
            self._seen |= zip(new, zip(*self._limits(source, np.array(new), near), strict=True), strict=True)
        begins, ends = zip(*(self._seen[time] for time in times.tolist()), strict=True)
        return np.array(begins), np.array(ends)

    def _limits(self, source: Trajectory, times: RealArray, near: float) -> tuple[RealArray, RealArray]:
        """Return right limits and left limits, each (N, orders, variables), of all references and their derivatives."""
        # breakpoints near a communication point replace it: left limits at the first of them, right limits at the last
        points = np.array(self.breakpoints)
        begin, end = points.searchsorted(times - near), points.searchsorted(times + near, "right")
        first, last, lands = times.copy(), times.copy(), begin < end
        first[lands], last[lands] = points[begin[lands]], points[end[lands] - 1]
        # right limits at all points, then left limits where they differ
        jumps = np.flatnonzero(np.isin(first, self.breakpoints))
        left = np.arange(times.size + jumps.size) >= times.size
        order = END_ORDER if self.ends_exactly else self.max_output_order
        jets = limits(source, np.concatenate([last, first[jumps]]), left, order + 2)
        stacked = np.concatenate([jets[kind : kind + order + 1] for kind in range(len(REFERENCES))], axis=2)
        both = np.ascontiguousarray(stacked.swapaxes(0, 1))
        begins, ends = both[: times.size], both[: times.size, : END_ORDER + 1].copy()
        ends[jumps] = both[times.size :, : END_ORDER + 1]
        return begins, ends

    @cached_property
    def _tabulated(self) -> Trajectory:
        """The tabulated trajectory; the trajectory itself if no table reproduces it."""
        try:
            return TabulatedTrajectory(self.trajectory)
        except ModelError:
            return self.trajectory


class TabulatedTrajectory:
    """Polynomials of degree 9 between knots, as in a trajectory's FMU, for position, velocity and acceleration.

    Higher derivatives are those of the acceleration's polynomials.

    Args:
        trajectory: trajectory to tabulate.

    Attributes:
        breakpoints: breakpoints of the trajectory [s].
        duration: duration of the motion [s].

    Raises:
        ModelError: no table reproduces the trajectory.
    """

    highest_order = ACCELERATION + END_ORDER

    def __init__(self, trajectory: Trajectory) -> None:
        # derivatives of position, velocity and acceleration at the knots
        table = tabulate(trajectory, TABLE_TOLERANCE)
        self.breakpoints = tuple(trajectory.breakpoints)
        self.duration = trajectory.duration
        # intervals between knots, and their polynomials; a knot that appears twice is a breakpoint
        begins = np.flatnonzero(np.diff(table.times) > 0.0)
        self._begins, widths = table.times[begins], np.diff(table.times)[begins]
        jets = table.jets.swapaxes(0, 1)
        self._polynomials = [
            hermite_derivatives(
                jets[k : k + END_ORDER + 1, begins], jets[k : k + END_ORDER + 1, begins + 1], widths[:, None]
            )
            for k in range(len(KINDS))
        ]
        self._rest = jets[0, [0, -1]]

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return value and time derivatives (order + 1, N, axes); see `flexfmu.trajectories.Trajectory.evaluate`.

        Raises:
            InputError: the order isn't 0 to 6.
        """
        if not 0 <= order <= self.highest_order:
            raise InputError(f"a tabulated trajectory has derivatives of orders 0 to {self.highest_order}, got {order}")
        # interval of each time, and the time since its beginning
        times = np.atleast_1d(np.asarray(time, dtype=np.float64))
        first, last = self.breakpoints[0], self.breakpoints[-1]
        early, late = (times < first, times >= last) if side == "right" else (times <= first, times > last)
        piece = np.maximum(np.searchsorted(self._begins, times, side) - 1, 0)
        elapsed = np.minimum(times, last) - self._begins[piece]
        # polynomials of these intervals, and the powers t^j / j! that all derivatives share
        here = [each[:, piece] for each in self._polynomials[: order + 1]]
        powers = np.array([elapsed**j / factorial(j) for j in range(len(here[0]))])
        jets = np.empty((order + 1, *here[0].shape[1:]))
        for k in range(order + 1):
            kind = min(k, ACCELERATION)
            terms = here[kind][k - kind :]
            np.einsum("jn,jna->na", powers[: len(terms)], terms, out=jets[k])
        # at rest before and after the motion
        for still, position in zip((early, late), self._rest, strict=True):
            jets[:, still] = 0.0
            jets[0, still] = position
        return jets


class FmuTrajectory:
    """A trajectory calculated by an FMU: `evaluate` steps the FMU from time to time.

    Args:
        path: FMU exported by `flexfmu.fmu_build.trajectory_build`.

    Attributes:
        breakpoints: breakpoints of the trajectory [s].
        axes: number of axes.

    Raises:
        FmuFileError: the FMU is missing or broken, or states no breakpoints.
    """

    def __init__(self, path: str | Path) -> None:
        points = open_fmu(Path(path)).breakpoints
        if not points:
            raise FmuFileError(f"{path} doesn't tell its breakpoints; run it as a slave that is stepped")
        self.breakpoints = points
        # one slave for left limits and one for right limits
        self._runs = {side: FmuSlave(path, f"trajectory, {side} limits", {"limit": side}) for side in get_args(Side)}
        variables = self._runs["right"].variables
        self._outputs = np.array([i for i, each in enumerate(variables) if each.causality == "output"], np.intp)
        self.axes = len(self._outputs) // len(KINDS)

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.breakpoints[-1]

    @property
    def highest_order(self) -> int:
        """Order of the highest derivative that the FMU provides."""
        return ACCELERATION + self._runs["right"].max_output_order

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return value and time derivatives (order + 1, N, axes); see `flexfmu.trajectories.Trajectory.evaluate`.

        Raises:
            InputError: the FMU doesn't provide derivatives of that order.
            SlaveError: the FMU fails.
        """
        if not 0 <= order <= self.highest_order:
            raise InputError(f"this trajectory has derivatives of orders 0 to {self.highest_order}, got order {order}")
        # the FMU runs forward through the different times, in ascending order
        times = np.atleast_1d(np.asarray(time, dtype=np.float64))
        instants, place = np.unique(times, return_inverse=True)
        fmu, axes = self._runs[side], self.axes
        signals = np.zeros((self.highest_order + 1, instants.size, axes))
        values, derivatives = np.empty(len(KINDS) * axes), np.empty((fmu.max_output_order, axes))
        if instants.size == 0:
            return signals[: order + 1]
        fmu.initialize(float(instants[0]), float(instants[-1]) + 1.0, None)
        try:
            # at each instant position, velocity, acceleration, then the derivatives of the acceleration
            for n, instant in enumerate(instants.tolist()):
                if n:
                    fmu.step(float(instants[n - 1]), instant - float(instants[n - 1]))
                fmu.get(self._outputs, values)
                fmu.get_derivatives(self._outputs[-axes:], derivatives)
                signals[: len(KINDS), n] = values.reshape(-1, axes)
                signals[len(KINDS) :, n] = derivatives
        finally:
            fmu.terminate()
        result: RealArray = signals[: order + 1][:, place.ravel()]
        return result
