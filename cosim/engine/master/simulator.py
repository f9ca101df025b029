"""A system with its order of calls and its time grid, prepared for any number of runs.

Estimates computing time and memory of a long run before it starts.

The computing time of a communication step is measured on the first steps, in a child process where the platform allows
it, so that the slaves don't change. Memory follows from the number of values.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np

from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, ChildLostError, in_child, portable
from flexfmu.cosim.engine.errors import CostWarning, InputError, SlaveEnded, SlaveError, SlaveWarning
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.algorithms import Algorithm, GaussSeidel
from flexfmu.cosim.engine.master.blocks import check_regular_steps, system_grid
from flexfmu.cosim.engine.master.c_library import load
from flexfmu.cosim.engine.master.compiled_loop import CompiledLoop, can_compile
from flexfmu.cosim.engine.master.coupling_error import CouplingError
from flexfmu.cosim.engine.master.couplings import Transport, feedback_signals
from flexfmu.cosim.engine.master.delays import SignalDelay, signal_delays
from flexfmu.cosim.engine.master.dependencies import Connection
from flexfmu.cosim.engine.master.grid import NO_POINTS
from flexfmu.cosim.engine.master.loops import check_can_save, needs_rollback
from flexfmu.cosim.engine.master.outcome import Outcome, Simulation, blown_up, message_of, outcome_of, overshot
from flexfmu.cosim.engine.master.recorder import SPEND_LESS, Recorder
from flexfmu.cosim.engine.master.schedule import Schedule
from flexfmu.cosim.engine.master.simulation_loop import Progress, SimulationLoop, StepStatistics
from flexfmu.cosim.engine.master.stability import find_alternation, find_instability
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.results import EVERYTHING, Column, Recording, Selection
from flexfmu.cosim.engine.slave import TEXTS, RealArray, Reports, Slave, Terminates

MANY_POINTS, MANY_VALUES = 10**7, 10**8
"""Numbers of communication steps and of recorded values above which the user is warned of the cost."""

FEW_STEPS, TRIED_STEPS = 500, 2500
"""Numbers of steps of the two trials; the initialisation cancels in the difference of their times."""

BYTES_PER_VALUE = 8.0
"""Bytes per recorded value; the results use the recorder's memory (`benchmarks/long_runs.py`)."""


def is_long(steps: int, values: int) -> bool:
    """Whether a run of so many steps and recorded values is long enough for a warning of its cost."""
    return steps > MANY_POINTS or values > MANY_VALUES


def cost(steps: int, values: int, trial: Callable[[int], Simulation]) -> str:
    """A sentence with a run's computing time and memory, and how to reduce them.

    Args:
        steps: communication steps.
        values: recorded values.
        trial: simulates the first steps, as many as its argument says.
    """
    seconds = None
    # an error occurs again in the run, which reports it better; the sentence then leaves out the time
    with suppress(Exception):
        seconds = (
            in_child(lambda: _seconds_per_step(trial), lambda: None, CALL_LIMIT)
            if AVAILABLE
            else _seconds_per_step(trial)
        )
    time = ""
    if seconds is not None:
        duration = seconds * steps
        unit, size = ("h", 3600.0) if duration > 5400.0 else ("min", 60.0) if duration > 90.0 else ("s", 1.0)
        time = f"{duration / size:.2g} {unit} and "
    gigabytes = 1e-9 * BYTES_PER_VALUE * values
    return (
        f"this run makes {steps:.3g} communication steps and records {values:.3g} values: it takes about {time}"
        f"{gigabytes:.2g} GB of memory or temporary files; to spend less, {SPEND_LESS}"
    )


def _seconds_per_step(trial: Callable[[int], Simulation]) -> float | None:
    """Computing time per communication step, references included [s]; None if a trial ends early."""
    taken = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # two trials, which take the same time to initialise
        for steps in (FEW_STEPS, TRIED_STEPS):
            begin = perf_counter()
            if trial(steps).steps < steps:
                return None
            taken.append(perf_counter() - begin)
    return max(taken[1] - taken[0], 0.0) / (TRIED_STEPS - FEW_STEPS)


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
    `flexfmu.cosim.engine.master.master.simulate`.
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
        self._options: Mapping[str, Any] = {
            "start": start,
            "algorithm": algorithm,
            "compiled": compiled,
            "record": record,
            "points": points,
        }
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
        may_compile = compiled is not False and step_control is None and can_compile(self._schedule)
        if may_compile and (library := load()) is not None:
            self._compiled = CompiledLoop(library, self._schedule, self._recorder)
        if step_control is not None:
            check_can_save(filter(needs_rollback, system.slaves), "step control")
            self._coupling_error(step_control)
        self._terminating = [(i, slave) for i, slave in enumerate(system.slaves) if isinstance(slave, Terminates)]
        self._delays: dict[float, tuple[SignalDelay, ...]] = {}

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
        """Co-simulate from start to stop; see `flexfmu.cosim.engine.master.master.simulate`.

        Args:
            tolerance: relative tolerance for the slaves' own integrators; None for their default.
            progress: called during the run with the simulated fraction, 0..1.
        """
        steps, values = self._grid.steps, self._recorder.values
        # warn of the cost of a long run
        if self._control is None and is_long(steps, values):

            def trial(steps: int) -> Simulation:
                """Simulate only the first ``steps`` communication steps."""
                first = Simulator(self._system, self._grid.time(steps), self._step, **self._options)
                return first._result(first._attempt(tolerance, None))

            warnings.warn(cost(steps, values, trial), CostWarning, stacklevel=2)
        self._recorder.rewind(0)
        if self._isolation is None:
            return self._result(self._attempt(tolerance, progress))
        return self._result(self._supervised(self._isolation, tolerance, progress))

    def _attempt(self, tolerance: float | None, progress: Progress | None) -> RunEnd:
        """Execute a run in this process; its end."""
        loop = SimulationLoop(self._schedule, self._grid, self._recorder, progress, self._compiled)
        if self._control is not None:
            loop.control_steps(self._control, self._coupling_error(self._control), self._step)
        error = self._completed(loop, tolerance)
        return RunEnd(error, loop.initialized, self._schedule.active_name, loop.reached)

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
        return RunEnd(error, recorder.count > 0, self._schedule.active_name, self._recorded_so_far())

    def _recorded_so_far(self) -> StepStatistics:
        """The time and steps of a run that was lost in its child process, from its recording."""
        time = self._recorder.times
        return StepStatistics(
            float(time[-1]) if time.size else self._grid.start,
            int((np.diff(time) > 0.0).sum()),
            0,
            self._grid.largest_step,
        )

    def _completed(self, loop: SimulationLoop, tolerance: float | None) -> BaseException | None:
        """Run the loop and terminate all slaves; returns the first error, if any."""
        try:
            error = _failure(lambda: loop.go(tolerance))
            if isinstance(error, SlaveEnded):
                self._record_end(error)
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

    def _record_end(self, ended: SlaveEnded) -> None:
        """Record the outputs of a slave that ended the run within a step.

        Only if it is the single slave: others would be at another time.
        """
        recorded = self._recorder.times
        if len(self._schedule.outputs) > 1 or ended.time is None or not recorded.size or ended.time <= recorded[-1]:
            return
        if _failure(lambda: self._schedule.outputs[0].read(float(recorded[-1]))) is None:
            self._recorder.append(ended.time)

    def _result(self, ending: RunEnd) -> Simulation:
        """The result of a run that has ended; warns of remarks of the slaves."""
        recording = _without_absent(self._recorder.recording(), self._system.slaves)
        _warn(recording, self._reporting)

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

    def _coupling_error(self, control: StepDoubling) -> CouplingError:
        """A new estimator of the coupling error; every run needs its own, since it adapts to the run's magnitudes."""
        span = self._grid.stop - self._grid.start
        return CouplingError(self._system, self._schedule.outputs, self._schedule.couplings, control, span)

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


def _without_absent(recording: Recording, slaves: Sequence[Slave]) -> Recording:
    """The recording without the output derivatives that FMUs did not provide."""
    changed = {}
    for slave in slaves:
        for output, order in slave.absent.items() if isinstance(slave, FmuSlave) else ():
            if (column := recording.columns.get(name := f"{slave.name}.{output}")) is not None:
                changed[name] = Column(column.unit, column.values, column.first if order > 1 else None, None)
    return recording.with_columns(changed) if changed else recording


def _warn(recording: Recording, slaves: Sequence[tuple[str, Reports]]) -> None:
    """Warn of differences between what slaves do and what they declare or were asked to do."""
    for name, slave in slaves:
        remarks = list(slave.remarks)
        if isinstance(slave, FmuSlave):
            remarks += slave.absence([each for each in slave.absent if f"{name}.{each}" in recording.columns])
        for remark in remarks:
            warnings.warn(f"{name}: {remark}", SlaveWarning, stacklevel=5)
