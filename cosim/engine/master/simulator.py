"""The master: simulates a system of slaves on one time grid and records their outputs, once or any number of times.

Runs with foreign code are simulated in a child process. It records into memory that it shares with its parent, which watches its
progress.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from time import perf_counter
from typing import Any

import numpy as np

from flexfmu.cosim.engine.child_process import AVAILABLE, ChildLostError, in_child, portable
from flexfmu.cosim.engine.errors import CostWarning, InputError, SlaveEnded, SlaveError, SlaveWarning
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.sampled_slave import FmuTask, SampledFmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.compiled_loop import CompiledLoop, load
from flexfmu.cosim.engine.master.couplings import Algorithm, GaussSeidel, Transport, feedback_signals
from flexfmu.cosim.engine.master.grid import NO_POINTS, Block, RunGrid, check_regular_steps, system_grid
from flexfmu.cosim.engine.master.loops import check_can_save, needs_rollback
from flexfmu.cosim.engine.master.outcome import (
    Outcome,
    SignalDelay,
    Simulation,
    blown_up,
    find_alternation,
    find_instability,
    message_of,
    outcome_of,
    overshot,
    signal_delays,
)
from flexfmu.cosim.engine.master.recorder import SPEND_LESS, Recorder
from flexfmu.cosim.engine.master.schedule import Schedule
from flexfmu.cosim.engine.master.step_control import ControlledSteps, StepDoubling
from flexfmu.cosim.engine.master.system import Connection, System
from flexfmu.cosim.engine.results import EVERYTHING, Column, Selection
from flexfmu.cosim.engine.slave import TEXTS, RealArray, Reports, Slave, Terminates

__all__ = ["Outcome", "Progress", "Simulation", "simulate"]

Progress = Callable[[float], None]
"""Called during a run with the simulated fraction, 0..1."""


def simulate(
    system: System,
    stop: float,
    step: float,
    *,
    start: float = 0.0,
    tolerance: float | None = None,
    progress: Progress | None = None,
    algorithm: Algorithm | None = None,
    step_control: StepDoubling | None = None,
    compiled: bool | None = None,
    record: Selection = EVERYTHING,
    isolation: float | None = None,
) -> Simulation:
    """Co-simulate a system from ``start`` to ``stop`` [s].

    Communication points are start + n * step, every breakpoint and every sample instant, met exactly. At one instant
    outputs are exchanged in the order of direct feedthrough, and algebraic loops are solved if the system has a solver.
    Over a step an input follows the polynomial that its source predicts, if it does; else the algorithm interpolates it
    between both ends of the step or extrapolates it from the beginning. The degree of the polynomial follows from the
    derivatives that the source gives and the target takes.

    Every run ends by terminating the slaves. A failing slave doesn't raise an exception: see `Simulation.outcome`; the
    recording ends with the last completed step.

    Args:
        system: slaves and connections.
        stop, start: [s].
        step: communication step [s]; with step control the length of the first one.
        tolerance: relative tolerance for the slaves' own integrators; None for their default.
        progress: called during the run with the simulated fraction, 0..1.
        algorithm: how slaves are coupled over a step: `GaussSeidel` (when None), `Jacobi` or `Implicit`.
        step_control: chooses the communication steps; None for a constant step.
        compiled: True or None to run the loop over the points in C if the system allows it (no step control, no loops
            to iterate) and there is a C compiler, False for Python; the results are the same.
        record: which outputs to record, with how many derivatives.
        isolation: for a run in a child process the longest duration of one call of a slave [s], `CALL_LIMIT` for example; a
            slave that crashes, exits or hangs ends only the run, and what slaves change in their own attributes stays
            there. None for this process.

    Returns:
        Recording, outcome, message and delays.

    Raises:
        InputError: the time grid is invalid, a sample time doesn't fit it, a slave needs equal steps but doesn't get
            them, a slave would have to be rolled back but can't save its state, or a signal to record doesn't exist.
    """
    simulator = Simulator(
        system,
        stop,
        step,
        start=start,
        algorithm=algorithm,
        step_control=step_control,
        compiled=compiled,
        record=record,
        isolation=isolation,
    )
    return simulator.run(tolerance, progress)


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


MANY_POINTS, MANY_VALUES = 10**7, 10**8
"""Numbers of communication steps and of recorded values above which the user is warned of the cost."""


@dataclass(frozen=True)
class RunEnd:
    """End of a run; a child process sends it to its parent.

    Attributes:
        error: the first exception, if any.
        initialized: whether all slaves have been initialised.
        active: name of the slave that was called last.
        reached: the time that the run reached, and its steps.
        reports: for each slave its report, see `Reports`.
        texts: all values of signals of type String, in the order of their codes.
    """

    error: BaseException | None
    initialized: bool
    active: str
    reached: StepStatistics
    reports: Sequence[Mapping[str, Any]] = ()
    texts: Sequence[str] = ()


class Simulator:
    """Prepares runs of a system once: time grid, ports, order of calls, and memory for the recording.

    The slaves' sample times and breakpoints must not change while the simulator is in use. Args and errors as for
    `flexfmu.cosim.engine.master.simulator.simulate`.
    """

    def __init__(
        self,
        system: System,
        stop: float,
        step: float,
        *,
        start: float = 0.0,
        algorithm: Algorithm | None = None,
        step_control: StepDoubling | None = None,
        compiled: bool | None = None,
        record: Selection = EVERYTHING,
        isolation: float | None = None,
        points: RealArray | None = None,
    ) -> None:
        outputs = [
            (slave.name, each.name) for slave in system.slaves for each in slave.variables if each.causality == "output"
        ]
        record.check([f"{slave}.{output}" for slave, output in outputs])
        self._system, self._step, self._control, self._selection = system, step, step_control, record
        # time grid, order of calls, memory for the recording
        ticks = step_control is None and points is None
        if record.step is not None and step_control is not None:
            raise InputError(
                "step control records all of its communication points: leave out the interval of the recording"
            )
        self._grid = system_grid(system, start, stop, step, ticks, NO_POINTS if points is None else points, record.step)
        check_regular_steps(system, self._grid, step, step_control is not None)
        chosen = GaussSeidel() if algorithm is None else algorithm
        # step control also monitors outputs that aren't recorded
        read = record if step_control is None else EVERYTHING
        self._schedule = Schedule(system, self._grid, chosen, read)
        # signals that may become unstable: those in closed loops, if some of them are extrapolated
        feedback, couplings = feedback_signals(system), self._schedule.couplings
        transports = {couplings[each.source, each.target].transport for each in feedback}
        self._feedback = self._source_names(feedback) if Transport.EXTRAPOLATED in transports else ()
        self._loops = feedback_signals(system, sampled=True)
        checked = {*self._feedback, *self._source_names(self._loops)}
        self._recorder = Recorder(
            self._schedule.outputs,
            self._grid.records,
            shared=isolation is not None,
            keeps=lambda name: read.keeps(name) or name in checked,
        )
        self._isolation = isolation
        # the loop over the points in C, if the plan allows it and there is a compiler
        self._compiled: CompiledLoop | None = None
        may_compile = compiled is not False and step_control is None and not self._schedule.plan.has_loops
        if may_compile and (library := load()) is not None:
            self._compiled = CompiledLoop(library, self._schedule, self._recorder)
        if step_control is not None:
            check_can_save(filter(needs_rollback, system.slaves), "step control")
        self._terminating = [(i, slave) for i, slave in enumerate(system.slaves) if isinstance(slave, Terminates)]
        self._delays: dict[float, tuple[SignalDelay, ...]] = {}

    @property
    def schedule(self) -> Schedule:
        """Ports and order of calls."""
        return self._schedule

    @property
    def recorder(self) -> Recorder:
        """Records every instant."""
        return self._recorder

    @property
    def is_compiled(self) -> bool:
        """Whether the loop over the points is the one in C, in this process."""
        return self._compiled is not None and self._isolation is None

    def move_to(self, stop: float) -> None:
        """Run to ``stop`` [s] from now on, over the present breakpoints of the slaves; no slave may be sampled.

        Raises:
            InputError: the time grid is invalid, or there is not enough memory for the recording.
        """
        ticks, every = self._control is None, self._selection.step
        grid = system_grid(self._system, self._grid.start, stop, self._step, ticks, record_step=every)
        check_regular_steps(self._system, grid, self._step, self._control is not None)
        self._grid = grid
        self._schedule.move_to(grid)
        self._recorder.expect(grid.records)

    def run(self, tolerance: float | None = None, progress: Progress | None = None) -> Simulation:
        """Co-simulate from start to stop; see `flexfmu.cosim.engine.master.simulator.simulate`.

        Args:
            tolerance: relative tolerance for the slaves' own integrators; None for their default.
            progress: called during the run with the simulated fraction, 0..1.
        """
        steps, values = self._grid.steps, self._recorder.values
        if self._control is None and (steps > MANY_POINTS or values > MANY_VALUES):
            warnings.warn(
                f"this run makes {steps:.3g} communication steps and records {values:.3g} values, {8e-9 * values:.2g} GB of memory "
                f"or temporary files; to spend less, {SPEND_LESS}",
                CostWarning,
                stacklevel=2,
            )
        self._recorder.rewind(0)
        if self._isolation is None:
            return self._result(self._attempt(tolerance, progress))
        return self._result(self._supervised(self._isolation, tolerance, progress))

    def _attempt(self, tolerance: float | None, progress: Progress | None) -> RunEnd:
        """Execute a run in this process; its end."""
        controlled: ControlledSteps | None = None
        if (control := self._control) is not None:
            controlled = ControlledSteps(self._schedule, self._recorder, control, self._step)
        loop = SimulationLoop(self._schedule, self._grid, self._recorder, progress, self._compiled, controlled)
        ended = self._completed(loop, tolerance)
        return RunEnd(ended, loop.initialized, self._schedule.active_name, loop.reached)

    def _supervised(self, call_limit: float, tolerance: float | None, progress: Progress | None) -> RunEnd:
        """Execute a run in a child process, which may crash, exit or hang; its end."""
        active, recorder, start, stop = self._schedule.active, self._recorder, self._grid.start, self._grid.stop
        active.value = 0

        # in the child: run, and make the ending picklable
        def attempt() -> RunEnd:
            recorder.populate()
            ending = self._attempt(tolerance, None)
            if (error := ending.error) is not None:
                error = portable(error, SlaveError(ending.active, f"{type(error).__name__}: {error}"))
            reports = [each.report() if isinstance(each, Reports) else {} for each in self._system.slaves]
            return replace(ending, error=error, reports=reports, texts=TEXTS.known())

        # in the parent, repeatedly: report progress; a change of the result shows that the child is still working
        def look() -> object:
            count = recorder.catch_up()
            if progress is not None and count:
                progress((recorder.last - start) / (stop - start))
            return count, active.value

        error: BaseException
        try:
            ending: RunEnd = in_child(attempt, look, call_limit)
            look()
            # changes of slaves stay in the child: take over texts and reports
            TEXTS.learn(ending.texts)
            for slave, report in zip(self._system.slaves, ending.reports, strict=True):
                if isinstance(slave, Reports):
                    slave.take_report(report)
            return ending
        except ChildLostError as lost:
            error = SlaveError(self._schedule.active_name, str(lost))
        except KeyboardInterrupt as interrupted:
            error = interrupted
        finally:
            recorder.catch_up()
        # time and steps from the recording
        time = recorder.times
        steps, reached = int((np.diff(time) > 0.0).sum()), float(time[-1]) if time.size else start
        progress_made = StepStatistics(reached, steps, 0, self._grid.largest_step)
        return RunEnd(error, recorder.count > 0, self._schedule.active_name, progress_made)

    def _completed(self, loop: SimulationLoop, tolerance: float | None) -> BaseException | None:
        """Run the loop and terminate all slaves; returns the first error, if any."""
        try:
            error = _failure(lambda: loop.go(tolerance))
            if isinstance(error, SlaveEnded):
                # record the outputs of a slave that ended the run within a step; other slaves would be at another time
                recorded, end, first, *others = self._recorder.times, error.time, *self._schedule.outputs
                is_later = end is not None and recorded.size and end > recorded[-1]
                if end and is_later and not others and not _failure(lambda: first.read(float(recorded[-1]))):
                    self._recorder.append(end)
        finally:
            # terminate all slaves in any case; the first error counts
            active = self._schedule.active.value
            for index, slave in self._terminating:
                self._schedule.active.value = index
                failure = _failure(slave.terminate)
                if error is None and failure is not None:
                    error, active = failure, index
            self._schedule.active.value = active
        return error

    def _result(self, ending: RunEnd) -> Simulation:
        """The result of a run that has ended; warns of remarks of the slaves."""
        recording, changed = self._recorder.recording(), dict[str, Column]()
        # without the output derivatives that FMUs did not provide
        for slave in self._system.slaves:
            for output, order in slave.absent.items() if isinstance(slave, FmuSlave) else ():
                if (column := recording.columns.get(name := f"{slave.name}.{output}")) is not None:
                    changed[name] = Column(column.unit, column.values, column.first if order > 1 else None, None)
        recording = recording.with_columns(changed) if changed else recording
        # differences between what slaves do and what they declare or were asked to do
        for name, reporting in self._reporting:
            remarks = list(reporting.remarks)
            if isinstance(reporting, FmuSlave):
                absent = [each for each in reporting.absent if f"{name}.{each}" in recording.columns]
                remarks += reporting.absence(absent)
            for remark in remarks:
                warnings.warn(f"{name}: {remark}", SlaveWarning, stacklevel=4)

        def values(names: Sequence[str]) -> Iterator[tuple[str, RealArray]]:
            return ((name, recording[name].values) for name in names)

        reached, error = ending.reached, ending.error
        # outcome and message from the error
        outcome = outcome_of(error, ending.initialized)
        message = message_of(error, outcome, ending.active, reached.time)
        # an unstable coupling (growing or alternating signals) takes precedence: it causes later errors
        if outcome is not Outcome.INTERRUPTED:
            ended = message if error is not None else ""
            overshooting = self._source_names(self._loops)
            if (unstable := find_instability(recording.time, values(self._feedback))) is not None:
                outcome, message = Outcome.COUPLING_UNSTABLE, blown_up(unstable, ended)
            elif (unstable := find_alternation(recording.time, values(overshooting))) is not None:
                targets = [each.target for each in self._loops if self._system.source_name(each) == unstable.signal]
                fed = [self._system.slaves[i].name for i in dict.fromkeys(targets)]
                outcome, message = Outcome.COUPLING_UNSTABLE, overshot(unstable, fed, ended)
        # selected signals, and delays
        error, step = error if outcome.is_failure else None, reached.largest_step
        if step not in self._delays:
            self._delays = {step: signal_delays(self._system, self._schedule.couplings, step)}
        kept, delays = self._selection.of(recording), self._delays[step]
        return Simulation(kept, outcome, message, error, reached.steps, reached.rejected, delays)

    @cached_property
    def _reporting(self) -> list[tuple[str, Reports]]:
        """Names and slaves of those that report, looked up after the first run, when all have their attributes."""
        return [(slave.name, slave) for slave in self._system.slaves if isinstance(slave, Reports)]

    def _source_names(self, connections: Sequence[Connection]) -> tuple[str, ...]:
        """Names of the outputs that these connections start from, without repetition."""
        return tuple(dict.fromkeys(self._system.source_name(each) for each in connections))


def _failure(action: Callable[[], None]) -> BaseException | None:
    """The exception that an action raises; None if it succeeds."""
    try:
        action()
    except (Exception, KeyboardInterrupt, SystemExit) as failure:
        return failure
    return None


def isolation(wanted: bool | None, slaves: Iterable[Slave], call_limit: float, *, caller_owned: bool) -> float | None:
    """The call limit [s] of a run of these slaves in a child process; None for a run in this process.

    Args:
        wanted: the user's choice; None isolates runs with foreign slaves, where the platform allows it.
        slaves: the slaves.
        call_limit: longest duration of one call of a slave [s].
        caller_owned: whether Python slaves are the caller's own objects, which the caller may read after the run; if
            ``wanted`` is None, such a run stays in this process.

    Raises:
        InputError: isolation is wanted on a platform other than Linux.
    """
    if wanted and not AVAILABLE:
        raise InputError(
            f"isolate = true needs Linux, this is {sys.platform}: leave `isolate` out to run all slaves in this process"
        )
    # isolate foreign slaves, but not objects that the caller may read after the run
    if wanted is None:
        foreign = [slave for slave in slaves if is_foreign(slave)]
        objects = caller_owned and any(not (hasattr(slave, "path") or hasattr(slave, "block")) for slave in foreign)
        wanted = AVAILABLE and bool(foreign) and not objects
    return call_limit if wanted else None


def is_foreign(slave: Slave) -> bool:
    """Whether a slave runs foreign code: an FMU of another tool, a Python class outside this package, or a user's function."""
    if isinstance(slave, FmuSlave | SampledFmu | FmuTask):
        return not open_fmu(slave.path).is_ours
    return getattr(slave, "has_foreign_code", False) or not type(slave).__module__.startswith("flexfmu.")
