"""A run on its way, from point to point of its grid."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

from flexfmu.cosim.compiled.run import CompiledRun
from flexfmu.cosim.errors import CostWarning
from flexfmu.cosim.master.controlled_steps import ControlledSteps
from flexfmu.cosim.master.coupling_error import CouplingError
from flexfmu.cosim.master.grid import TimeGrid
from flexfmu.cosim.master.recorder import SPEND_LESS, Recorder
from flexfmu.cosim.master.schedule import Schedule
from flexfmu.cosim.master.step_control import ErrorBudget, StepDoubling

Progress = Callable[[float], None]
"""Called now and then with the simulated fraction, 0..1."""

PROGRESS_CALLS = 100
"""How often progress is told in a run."""

MANY_POINTS, MANY_VALUES = 10**7, 10**8
"""What more communication points or recorded values will cost is told."""

SAMPLE, SAMPLE_TIME = 0.01, 2.0
"""Fraction of the points, or seconds, from which the time of all is estimated."""

BYTES_PER_VALUE = 19.0
"""Memory of a recorded value, as it comes and in its column (`benchmarks/long_runs.py`)."""

BYTES_PER_VALUE_IN_FILES = 50.0
"""The same while results.csv is written."""

UNINTERRUPTED = 100
"""Points that are run without looking whether the user interrupts."""


@dataclass(frozen=True)
class Reached:
    """How far a run came.

    Attributes:
        time: end of the last completed step [s].
        steps: completed communication steps.
        rejected: steps that were taken back.
        largest_step: [s].
    """

    time: float
    steps: int
    rejected: int
    largest_step: float


class Run:
    """Goes from point to point of a grid and records them.

    Args:
        schedule: whose turn it is.
        grid: the points.
        recorder: gets every instant.
        progress: told now and then.
        compiled: the loop in C; None for Python.

    Attributes:
        initialized: whether all slaves have been initialised.
    """

    def __init__(
        self,
        schedule: Schedule,
        grid: TimeGrid,
        recorder: Recorder,
        progress: Progress | None,
        compiled: CompiledRun | None = None,
    ) -> None:
        self._recorder = recorder
        self.initialized = False
        self._schedule, self._grid = schedule, grid
        self._compiled = compiled
        self._cross = schedule.advance
        self._controlled: ControlledSteps | None = None
        self._passed = 0
        self._progress = progress

    def control_steps(self, control: StepDoubling, error: CouplingError, first: float) -> None:
        """Take as many steps between the grid's points as a tolerance needs, the first one of length ``first`` [s]."""
        budget = ErrorBudget(float(self._grid.times[0]), float(self._grid.times[-1]))
        self._controlled = ControlledSteps(self._schedule, self._recorder, control, error, first, budget)
        self._cross = self._controlled.cross

    def go(self, tolerance: float | None) -> None:
        """Initialise, then go from point to point.

        An instant is recorded once where signals are continuous, on both sides where they may jump.
        """
        self._schedule.initialize(tolerance)
        self.initialized = True
        self._start()
        self._began, self._foreseen = perf_counter(), False
        if self._compiled is not None:
            self._go_in_c(self._compiled)
            return
        try:
            self._go_in_python()
        finally:
            if self._controlled is not None:
                self._controlled.finish()

    def _go_in_c(self, compiled: CompiledRun) -> None:
        """A piece of the way at a time, between which progress is told and the user can interrupt."""
        compiled.begin()
        count = self._grid.times.size - 1
        pieces = min(PROGRESS_CALLS, count) if self._progress is not None else 1 + count // UNINTERRUPTED
        try:
            for piece in range(1, pieces + 1):
                compiled.go(count * piece // pieces)
                self._foresee(compiled.points)
                if self._progress is not None:
                    self._progress(piece / pieces)
        finally:
            self._passed = compiled.points

    def _go_in_python(self) -> None:
        times, marked, cross = self._grid.times.tolist(), self._grid.marked.tolist(), self._cross
        exchange, record = self._schedule.exchange, self._recorder.append
        count = len(times) - 1
        every = max(1, count // PROGRESS_CALLS)
        for n in range(count):
            time, jump = times[n + 1], marked[n + 1]
            cross(times[n], time)
            self._passed += 1
            if n % UNINTERRUPTED == 0:
                self._foresee(n)
            if jump:
                record(time)
            exchange(n + 1, time, jump)
            record(time)
            if self._progress is not None and (self._passed % every == 0 or self._passed == count):
                self._progress((time - times[0]) / (times[-1] - times[0]))

    def _foresee(self, points: int) -> None:
        """Warn of the time and memory that a long run will take, as soon as its first points tell; how much step control
        will do isn't known."""
        count, values = self._grid.times.size - 1, self._recorder.values
        if self._foreseen or points == 0:
            return
        seconds = perf_counter() - self._began
        if points < SAMPLE * count and seconds < SAMPLE_TIME:
            return
        self._foreseen = True
        if self._controlled is None and (count > MANY_POINTS or values > MANY_VALUES):
            warnings.warn(
                f"this run makes {count:.3g} communication steps and records {values:.3g} values: about "
                f"{_duration(seconds / points * count)} and {BYTES_PER_VALUE * 1e-9 * values:.2g} GB of memory, "
                f"{BYTES_PER_VALUE_IN_FILES * 1e-9 * values:.2g} GB where results.csv is written; to spend less, {SPEND_LESS}",
                CostWarning,
                stacklevel=2,
            )

    @property
    def reached(self) -> Reached:
        """How far the run came."""
        time, steps, largest = float(self._grid.times[self._passed]), self._passed, self._grid.largest_step
        if self._controlled is None:
            return Reached(time, steps, 0, largest)
        taken = self._controlled
        return Reached(max(time, taken.time), taken.accepted, taken.rejected, taken.largest or largest)

    def _start(self) -> None:
        """Exchange and record the first instant."""
        start = float(self._grid.times[0])
        if self._grid.marked[0]:
            self._recorder.append(start)
        self._schedule.exchange(0, start, jump=True)
        self._recorder.append(start)


def _duration(seconds: float) -> str:
    """Seconds, minutes or hours."""
    unit, size = ("h", 3600.0) if seconds > 5400.0 else ("min", 60.0) if seconds > 90.0 else ("s", 1.0)
    return f"{seconds / size:.2g} {unit}"
