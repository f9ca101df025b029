"""The loop of a run over the points of its time grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flexfmu.cosim.engine.master.compiled_loop import CompiledLoop
from flexfmu.cosim.engine.master.controlled_steps import ControlledSteps
from flexfmu.cosim.engine.master.coupling_error import CouplingError
from flexfmu.cosim.engine.master.grid import TimeGrid
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import Schedule
from flexfmu.cosim.engine.master.step_control import ErrorBudget, StepDoubling

Progress = Callable[[float], None]
"""Called during a run with the simulated fraction, 0..1."""

PROGRESS_CALLS = 100
"""Number of progress reports in a run."""

UNINTERRUPTED = 100
"""Number of points that the loop in C runs before Python checks whether the user interrupts."""


@dataclass(frozen=True)
class StepStatistics:
    """The time that a run reached, and its steps.

    Attributes:
        time: end of the last completed step [s].
        steps: number of completed communication steps.
        rejected: number of steps that were rolled back.
        largest_step: largest communication step [s].
    """

    time: float
    steps: int
    rejected: int
    largest_step: float


class SimulationLoop:
    """Executes one run over the points of a grid and records them.

    Args:
        schedule: ports and order of calls.
        grid: communication points.
        recorder: records every instant.
        progress: called during the run with the simulated fraction; None for no reports.
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
        compiled: CompiledLoop | None = None,
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
        """Control the steps between the grid's points.

        Args:
            control: tolerance and limits of the steps.
            error: estimates the coupling error.
            first: length of the first step [s].
        """
        budget = ErrorBudget(float(self._grid.times[0]), float(self._grid.times[-1]))
        self._controlled = ControlledSteps(self._schedule, self._recorder, control, error, first, budget)
        self._cross = self._controlled.cross

    def go(self, tolerance: float | None) -> None:
        """Initialise the slaves and execute the run.

        An instant is recorded once where signals are continuous, and twice (left and right limits) where they may jump.

        Args:
            tolerance: relative tolerance for the slaves' own integrators; None for their default.
        """
        # initialisation and first exchange
        self._schedule.initialize(tolerance)
        self.initialized = True
        self._start()
        # the points of the grid, in C or in Python
        if self._compiled is not None:
            self._go_in_c(self._compiled)
            return
        try:
            self._go_in_python()
        finally:
            if self._controlled is not None:
                self._controlled.finish()

    def _go_in_c(self, compiled: CompiledLoop) -> None:
        """Run in pieces; between two pieces progress is reported and the user can interrupt."""
        compiled.begin()
        count = self._grid.times.size - 1
        # one piece per progress report, or per check for an interruption
        pieces = min(PROGRESS_CALLS, count) if self._progress is not None else 1 + count // UNINTERRUPTED
        try:
            for piece in range(1, pieces + 1):
                compiled.go(count * piece // pieces)
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
            # left limits where signals may jump, then the exchange, then right limits
            if jump:
                record(time)
            exchange(n + 1, time, jump)
            record(time)
            if self._progress is not None and (self._passed % every == 0 or self._passed == count):
                self._progress((time - times[0]) / (times[-1] - times[0]))

    @property
    def reached(self) -> StepStatistics:
        """The time that the run reached, and its steps."""
        time, steps, largest = float(self._grid.times[self._passed]), self._passed, self._grid.largest_step
        if self._controlled is None:
            return StepStatistics(time, steps, 0, largest)
        taken = self._controlled
        return StepStatistics(max(time, taken.time), taken.accepted, taken.rejected, taken.largest or largest)

    def _start(self) -> None:
        """Exchange and record the first instant."""
        start = float(self._grid.times[0])
        if self._grid.marked[0]:
            self._recorder.append(start)
        self._schedule.exchange(0, start, jump=True)
        self._recorder.append(start)
