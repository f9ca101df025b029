"""A run on its way, from point to point of its grid."""

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
"""Called now and then with the simulated fraction, 0..1."""

PROGRESS_CALLS = 100
"""How often progress is reported in a run."""

UNINTERRUPTED = 100
"""Points that are run without looking whether the user interrupts."""


@dataclass(frozen=True)
class StepStatistics:
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


class SimulationLoop:
    """Goes from point to point of a grid and records them.

    Args:
        schedule: the order of calls.
        grid: the points.
        recorder: gets every instant.
        progress: called now and then.
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
        if self._compiled is not None:
            self._go_in_c(self._compiled)
            return
        try:
            self._go_in_python()
        finally:
            if self._controlled is not None:
                self._controlled.finish()

    def _go_in_c(self, compiled: CompiledLoop) -> None:
        """Run piece by piece; between the pieces progress is reported and the user can interrupt."""
        compiled.begin()
        count = self._grid.times.size - 1
        # as many pieces as there are reports of progress, or looks for an interruption
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
        """How far the run came."""
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
