"""The loop of a run over the points of its time grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import perf_counter

from flexfmu.cosim.engine.master.blocks import Block, RunGrid
from flexfmu.cosim.engine.master.compiled_loop import CompiledLoop
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import Schedule
from flexfmu.cosim.engine.master.step_control import ControlledSteps

Progress = Callable[[float], None]
"""Called during a run with the simulated fraction, 0..1."""

PROGRESS_CALLS = 100
"""Number of progress reports in a run."""

UNINTERRUPTED = 100
"""Number of points that the loop in C runs at first before Python checks whether the user interrupts."""

QUICK = 5e-3
"""Time [s] below which the next piece is twice as long, so that a user waits at most some 10 ms for an interruption."""


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
        controlled: controls the steps between the grid's points; None for steps from point to point.

    Attributes:
        initialized: whether all slaves have been initialised.
    """

    def __init__(
        self,
        schedule: Schedule,
        grid: RunGrid,
        recorder: Recorder,
        progress: Progress | None,
        compiled: CompiledLoop | None = None,
        controlled: ControlledSteps | None = None,
    ) -> None:
        self.initialized = False
        self._schedule, self._grid, self._recorder = schedule, grid, recorder
        self._progress, self._compiled, self._controlled = progress, compiled, controlled
        # the current block, the steps completed in it, and those before it
        self._block: Block | None = None
        self._passed = self._before = 0

    def go(self, tolerance: float | None) -> None:
        """Initialise the slaves and execute the run.

        An instant is recorded once where signals are continuous, and twice (left and right limits) where they may jump.

        Args:
            tolerance: relative tolerance for the slaves' own integrators; None for their default.
        """
        # block by block, in C or in Python
        pass_through = self._go_in_python if self._compiled is None else partial(self._go_in_c, self._compiled)
        try:
            for block in self._grid.blocks():
                if self._block is None:
                    self._start(block, tolerance)
                else:
                    self._before += self._block.steps
                    self._schedule.enter(block)
                self._block, self._passed = block, 0
                pass_through(block)
        finally:
            if self._controlled is not None:
                self._controlled.finish()

    def _start(self, block: Block, tolerance: float | None) -> None:
        """Initialise the slaves; exchange and record the first instant."""
        self._schedule.initialize(block, tolerance)
        self.initialized = True
        if block.grid.marked[0]:
            self._recorder.append(self._grid.start)
        self._schedule.exchange(0, self._grid.start, jump=True)
        self._recorder.append(self._grid.start)

    def _go_in_c(self, compiled: CompiledLoop, block: Block) -> None:
        """Run a block in pieces; between two pieces progress is reported and the user can interrupt."""
        compiled.enter(block.grid)
        # one piece per progress report, or per check for an interruption
        count = self._grid.steps
        length = UNINTERRUPTED if self._progress is None else -(-count // PROGRESS_CALLS)
        try:
            while compiled.points < block.steps:
                # pieces are multiples of the length, counted from the start of the run
                end = (self._before + compiled.points) // length * length + length - self._before
                started = perf_counter()
                compiled.go(min(end, block.steps))
                if self._progress is not None:
                    self._progress((self._before + compiled.points) / count)
                elif perf_counter() - started < QUICK:
                    length *= 2
        finally:
            self._passed = compiled.points

    def _go_in_python(self, block: Block) -> None:
        times, marked = block.grid.times.tolist(), block.grid.marked.tolist()
        cross = self._schedule.advance if self._controlled is None else self._controlled.cross
        recorded = block.grid.instants.tolist()
        exchange, record = self._schedule.exchange, self._recorder.append
        start, stop, count = self._grid.start, self._grid.stop, self._grid.steps
        every = max(1, count // PROGRESS_CALLS)
        for n in range(block.steps):
            time, jump = times[n + 1], marked[n + 1]
            cross(times[n], time)
            self._passed += 1
            # left limits where signals may jump, then the exchange, then right limits
            if jump and recorded[n + 1]:
                record(time)
            exchange(n + 1, time, jump)
            if recorded[n + 1]:
                record(time)
            passed = self._before + self._passed
            if self._progress is not None and (passed % every == 0 or passed == count):
                self._progress((time - start) / (stop - start))

    @property
    def reached(self) -> StepStatistics:
        """The time that the run reached, and its steps."""
        time = self._grid.start if self._block is None else float(self._block.grid.times[self._passed])
        steps, largest = self._before + self._passed, self._grid.largest_step
        if self._controlled is None:
            return StepStatistics(time, steps, 0, largest)
        taken = self._controlled
        return StepStatistics(max(time, taken.time), taken.accepted, taken.rejected, taken.largest or largest)
