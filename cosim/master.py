"""The master: advances a system of slaves on one time grid and records what they do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

from flexfmu.cosim.errors import NotFiniteError, SlaveError
from flexfmu.cosim.grid import TimeGrid, sample_instants, time_grid
from flexfmu.cosim.recorder import Recorder
from flexfmu.cosim.results import Recording
from flexfmu.cosim.schedule import Schedule
from flexfmu.cosim.slave import KnowsItsFuture, Sampled, Terminates
from flexfmu.cosim.system import System

Progress = Callable[[float], None]
"""Called now and then with the simulated fraction, 0..1."""

PROGRESS_CALLS = 100
"""How often progress is told in a run."""


class Outcome(Enum):
    """How a simulation ended; the value is a sentence for people."""

    COMPLETED = "the simulation reached its stop time"
    INITIALISATION_FAILED = "a slave could not be initialised; check its parameters and start values"
    STEP_FAILED = "a slave failed within a communication step; the results end before it"
    NOT_FINITE = "a slave's output became infinite or not a number; the results end before it"
    INTERRUPTED = "the simulation was interrupted; the results end there"


@dataclass(frozen=True)
class Simulation:
    """What a run gave.

    Attributes:
        recording: all outputs, named ``slave.variable``, up to where the run came.
        outcome: how it ended.
        message: what happened, in one line: which slave, when, and its own words.
        error: the exception that ended the run; None when it completed.
        steps: completed communication steps.
    """

    recording: Recording
    outcome: Outcome
    message: str
    error: BaseException | None
    steps: int


def simulate(
    system: System,
    stop: float,
    step: float,
    *,
    start: float = 0.0,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Simulation:
    """Co-simulate a system from ``start`` to ``stop`` [s].

    Communication points are start + n * step, every breakpoint and every sample instant, hit exactly. At one instant
    outputs are exchanged in the order of direct feedthrough. Over a step an input follows the polynomial that its
    source announced; else it interpolates between both ends of the step where the source has been advanced first, or
    extrapolates (`System.delayed`). Its degree follows from the derivatives that source and target can handle.

    Every run ends by terminating the slaves. A failing slave doesn't raise: the outcome tells, and the recording holds
    everything up to the last completed step.

    Raises:
        InputError: the time grid makes no sense.
    """
    grid = time_grid(start, stop, step, _marks(system, start, stop))
    run = _Run(system, grid, progress)
    error: BaseException | None = None
    try:
        run.go(tolerance)
    except (Exception, KeyboardInterrupt) as failure:
        error = failure
    finally:
        for slave in system.slaves:
            if isinstance(slave, Terminates):
                slave.terminate()
    return Simulation(run.recorder.recording(), run.outcome(error), run.message(error), error, run.steps)


def _marks(system: System, start: float, stop: float) -> Iterator[float]:
    """Instants at which signals may jump."""
    for slave in system.slaves:
        if isinstance(slave, KnowsItsFuture):
            yield from slave.breakpoints
        if isinstance(slave, Sampled):
            yield from sample_instants(slave.sample_time, start, stop)


class _Run:
    """A run on its way: what has been recorded, and how far it has come."""

    def __init__(self, system: System, grid: TimeGrid, progress: Progress | None) -> None:
        self.schedule = Schedule(system, grid)
        self.recorder = Recorder(self.schedule.outputs, grid.times.size + int(grid.marked.sum()))
        self.steps = 0
        self._times: list[float] = grid.times.tolist()
        self._marked: list[bool] = grid.marked.tolist()
        self._initialized = False
        self._progress = progress

    def go(self, tolerance: float | None) -> None:
        """Initialise, then step from communication point to communication point."""
        self.schedule.initialize(tolerance)
        self._initialized = True
        self._exchange_and_record(0)
        count = len(self._times) - 1
        every = max(1, count // PROGRESS_CALLS)
        for n in range(count):
            self.schedule.advance(self._times[n], self._times[n + 1])
            self.steps += 1
            self._exchange_and_record(n + 1)
            if self._progress is not None and (self.steps % every == 0 or self.steps == count):
                self._progress(self.steps / count)

    def _exchange_and_record(self, point: int) -> None:
        """Record the instant: once where signals are continuous, on both sides where they may jump."""
        time, jump = self._times[point], self._marked[point]
        if jump:
            self.recorder.append(time)
        self.schedule.exchange(point, time, jump or point == 0)
        self.recorder.append(time)

    def outcome(self, error: BaseException | None) -> Outcome:
        """How the run ended."""
        if error is None:
            return Outcome.COMPLETED
        if isinstance(error, KeyboardInterrupt):
            return Outcome.INTERRUPTED
        if not self._initialized:
            return Outcome.INITIALISATION_FAILED
        return Outcome.NOT_FINITE if isinstance(error, NotFiniteError) else Outcome.STEP_FAILED

    def message(self, error: BaseException | None) -> str:
        """What happened, in one line."""
        if error is None or isinstance(error, KeyboardInterrupt):
            return self.outcome(error).value
        slave = error.slave if isinstance(error, SlaveError) else self.schedule.active
        reason = error.reason if isinstance(error, SlaveError) else f"{type(error).__name__}: {error}"
        reached = getattr(error, "time", None)
        when = f" at {self._times[self.steps] if reached is None else reached:.9g} s"
        return f"{slave} failed{'' if when in reason else when}: {' '.join(reason.split())}"
