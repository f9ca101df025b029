"""The loop of a run over the points of its time grid; and communication steps with error control, by step doubling with rollback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf
from time import perf_counter

import numpy as np

from flexfmu.cosim.engine.errors import LoopError, SlaveError, StepSizeError, WorkError
from flexfmu.cosim.engine.master.blocks import Block, RunGrid
from flexfmu.cosim.engine.master.compiled_loop import CompiledLoop
from flexfmu.cosim.engine.master.coupling_error import CouplingError
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import OFF_GRID, Schedule, Snapshot
from flexfmu.cosim.engine.master.step_control import GROW, ErrorBudget, StepDoubling, fitted
from flexfmu.cosim.engine.slave import RealArray

WORK_AT_START, WORK = 1e5, 100.0
"""Maximum number of steps: WORK_AT_START, plus WORK times the number of steps of the first one's length."""


class ControlledSteps:
    """Steps the slaves from one grid point to the next with a bounded coupling error.

    Each step is taken once as a whole and once in two halves; the halves are kept. Their difference estimates the local
    error; if it is too large, the slaves are rolled back and a smaller step is tried. A second solution takes the whole steps
    only and is never corrected. Its difference from the first solution estimates the error accumulated since it began. (Both by
    Richardson extrapolation.)

    Attributes:
        time: end of the last accepted step [s].
        accepted, rejected: number of steps so far; the two halves of an accepted step count as two.
        largest: largest accepted half step [s].
    """

    def __init__(
        self,
        schedule: Schedule,
        recorder: Recorder,
        control: StepDoubling,
        error: CouplingError,
        first: float,
        budget: ErrorBudget,
    ) -> None:
        self.time = self._mark = -inf
        self.accepted = self.rejected = 0
        self.largest = 0.0
        self._schedule, self._recorder = schedule, recorder
        self._control, self._error, self._budget = control, error, budget
        # length of the next step, smallest step, and maximum number of steps
        self._step = min(first, control.largest)
        self._least = control.least(first)
        self._first, self._most = first, WORK_AT_START + WORK * budget.span / first
        # signals at the end of the last step, and snapshots to roll back to: of the run, and of the second solution
        self._signals = np.empty(0)
        self._short: Snapshot | None = None
        self._long: Snapshot | None = None

    def cross(self, begin: float, end: float) -> None:
        """Step from ``begin`` to ``end`` [s]; exchange and record at every point between them, not at the end.

        Raises:
            StepSizeError: the error exceeds the tolerance even with the smallest step.
            WorkError: the run has taken more steps than allowed.
            SlaveError: a slave fails even in the smallest step.
            LoopError: an iteration doesn't converge even in the smallest step.
        """
        # signals may have jumped at this point: include their new magnitudes
        self.time, self._mark = begin, begin
        if self.accepted == 0:
            self._error.start(self._schedule.inputs)
        self._signals = self._error.signals()
        self._error.learn(self._signals)
        try:
            self._short = self._schedule.save()
            # steps up to the point, with exchange and recording between them
            while self.time < end:
                if self.time > begin:
                    if self._schedule.predicting:
                        self._schedule.exchange(OFF_GRID, self.time, False)
                    self._recorder.append(self.time)
                self._advance(end)
        finally:
            self._short = _replaced(self._short, None)
            if self._schedule.due:
                self.finish()

    def finish(self) -> None:
        """End the second solution: after the run, and at each grid point if slaves sample.

        The states of sampled slaves are not saved.
        """
        self._long = _replaced(self._long, None)
        self._budget.carry()

    def _advance(self, end: float) -> None:
        """Take one step that meets the tolerance, no further than ``end`` [s]."""
        # reduce the step until the error is small enough
        wanted, rejected = self._step, self.rejected
        while True:
            self._check_work(end)
            step = fitted(max(self._step, self._least), end - self.time)
            reached = self.time + step if step < end - self.time else end
            error, added = self._try(reached)
            proposal = self._control.next_step(step, error, self._error.order)
            if error <= 1.0:
                break
            self.rejected += 1
            self._step = proposal
        # update the error budget
        self._budget.spend(step, added, self._accumulated(reached, added, reached < end or not self._schedule.due))
        # after a step that was shortened only to end on the point, keep the length wanted before
        shortened = self.rejected == rejected and proposal >= GROW * step
        self._step = max(proposal, wanted) if shortened else proposal
        self.time = reached
        self.accepted += 2
        self.largest = max(self.largest, 0.5 * step)

    def _try(self, end: float) -> tuple[float, float]:
        """Take a step as a whole and in two halves; roll back if its error is too large.

        A failing slave or a loop that doesn't converge counts as an infinite error: a smaller step may succeed.

        Returns:
            The error relative to what the step may add (the largest of all signals), and relative to the tolerance.
        """
        # error of the worst signal; infinite if the step fails
        recorded, step, worst = self._recorder.count, end - self.time, ""
        error = added = inf
        try:
            errors, grown = self._double(end)
            ratios = errors / self._budget.allowed(self.time, end, grown)
            error, added = float(ratios.max(initial=0.0)), float(errors.max(initial=0.0))
            worst = self._error.name(int(np.argmax(ratios))) if ratios.size else ""
        except (SlaveError, LoopError):
            if step <= self._least:
                raise
        # too large: roll back, or give up at the smallest step
        if error > 1.0:
            if step <= self._least:
                raise StepSizeError(self._complaint(worst, step, error))
            self._recorder.rewind(recorded)
            self._restore(self._short)
        return error, added

    def _double(self, end: float) -> tuple[RealArray, RealArray]:
        """Take the step as a whole, roll back, take it in two halves and record the middle.

        Returns:
            What `CouplingError.compare` returns for both.
        """
        schedule, begin = self._schedule, self.time
        # as a whole
        middle, at_once = begin + 0.5 * (end - begin), self._at_once(end, goes_on=False)
        self._restore(self._short)
        # in two halves
        schedule.begin(begin, middle, end)
        schedule.advance(begin, middle)
        schedule.exchange(OFF_GRID, middle, False)
        self._recorder.append(middle)
        schedule.advance(middle, end)
        schedule.refresh(end, self._error.following)
        self._signals = self._error.signals()
        return self._error.compare(self._signals, at_once)

    def _at_once(self, end: float, jump: bool = False, goes_on: bool = True) -> RealArray:
        """Take a step as a whole; the signals (n,) at its end.

        Args:
            end: of the step [s].
            jump: whether signals may jump at its beginning.
            goes_on: whether another step continues from its end.
        """
        self._schedule.begin(self.time, end, jump=jump)
        self._schedule.advance(self.time, end)
        if goes_on or self._error.following:
            self._schedule.refresh(end, self._error.following)
        return self._error.signals()

    def _accumulated(self, end: float, added: float, goes_on: bool) -> float:
        """Continue the second solution to ``end`` [s]; the error accumulated since it began, relative to the tolerance.

        Args:
            end: of the step [s].
            added: the step's own error; returned where there is no second solution.
            goes_on: whether the second solution continues from ``end``.
        """
        self._error.learn(self._signals)
        # without a second solution, before or after this step, only the step's own error is known
        before = self._long or self._short
        if before is self._short and not goes_on:
            return added
        schedule, kept = self._schedule, self._schedule.save()
        try:
            # the second solution: one whole step further
            self._restore(before)
            long = self._at_once(end, jump=self.time == self._mark, goes_on=goes_on)
            self._long = _replaced(self._long, schedule.save() if goes_on else None)
        except (SlaveError, LoopError):
            # the step is too long for a slave or a loop: the second solution restarts
            self._long, long = _replaced(self._long, None), None
            self._budget.carry()
        # back to the first solution, from which the next step begins
        self._short = _replaced(self._short, kept)
        self._restore(kept)
        return added if long is None else float(self._error.learned(self._signals, long).max(initial=0.0))

    def _restore(self, snapshot: Snapshot | None) -> None:
        """Roll back to a snapshot, if there is one."""
        if snapshot is not None:
            self._schedule.restore(snapshot)

    def _check_work(self, end: float) -> None:
        """Refuse another step once the maximum number of steps is exceeded.

        Raises:
            WorkError: it is exceeded.
        """
        steps = self.accepted + self.rejected
        if steps > self._most:
            raise WorkError(
                f"step control has made {steps} steps up to {self.time:.9g} s, where the run goes on beyond {end:.9g} s, and "
                f"is at steps of {self._step:.3g} s: far more than steps of {self._first:.3g} s would be; take a larger "
                f"tolerance, derivatives of inputs and outputs or a softer coupling, a larger `minimum`, or a smaller first "
                f"step if so many are meant"
            )

    def _complaint(self, worst: str, step: float, error: float) -> str:
        """Message for an error that is too large at the smallest step."""
        return (
            f"the coupling error of {worst} is {error:.3g} times what the tolerance of {self._control.tolerance:g} allows "
            f"at {self.time:.9g} s, even with a step of {step:.3g} s; take a larger tolerance, a smaller smallest step, "
            f"or a higher precision within the slaves"
        )


def _replaced(old: Snapshot | None, new: Snapshot | None) -> Snapshot | None:
    """The new snapshot, after the states of the old one have been released."""
    if old is not None:
        old.states.release()
    return new


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
    ) -> None:
        self.initialized = False
        self._schedule, self._grid, self._recorder = schedule, grid, recorder
        self._progress, self._compiled, self._cross = progress, compiled, schedule.advance
        self._controlled: ControlledSteps | None = None
        # the current block, the steps completed in it, and those before it
        self._block: Block | None = None
        self._passed = self._before = 0

    def control_steps(self, control: StepDoubling, error: CouplingError, first: float) -> None:
        """Control the steps between the grid's points.

        Args:
            control: tolerance and limits of the steps.
            error: estimates the coupling error.
            first: length of the first step [s].
        """
        budget = ErrorBudget(self._grid.start, self._grid.stop)
        self._controlled = ControlledSteps(self._schedule, self._recorder, control, error, first, budget)
        self._cross = self._controlled.cross

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
        times, marked, cross = block.grid.times.tolist(), block.grid.marked.tolist(), self._cross
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
