"""The master: advances a system of slaves on one time grid and records what they do."""

from __future__ import annotations

from flexfmu.cosim.algorithms import Algorithm, GaussSeidel
from flexfmu.cosim.compiled.library import load
from flexfmu.cosim.coupling_error import CouplingError
from flexfmu.cosim.delays import signal_delays
from flexfmu.cosim.errors import LoopError, NotFiniteError, SlaveError, StepSizeError
from flexfmu.cosim.grid import Clock, time_grid
from flexfmu.cosim.links import Transport
from flexfmu.cosim.outcome import Outcome, Simulation
from flexfmu.cosim.results import Recording
from flexfmu.cosim.run import Progress, Run
from flexfmu.cosim.schedule import Schedule
from flexfmu.cosim.slave import HasBreakpoints, Sampled, Terminates, offset
from flexfmu.cosim.stability import Instability, find_instability
from flexfmu.cosim.state import check_can_save, revocable
from flexfmu.cosim.step_control import StepDoubling
from flexfmu.cosim.stepping_order import feedback_signals
from flexfmu.cosim.system import System

__all__ = ["Outcome", "Progress", "Simulation", "simulate"]


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
) -> Simulation:
    """Co-simulate a system from ``start`` to ``stop`` [s].

    Communication points are start + n * step, every breakpoint and every sample instant, hit exactly. At one instant
    outputs are exchanged in the order of direct feedthrough, and algebraic loops are solved if the system has a solver.
    Over a step an input follows the polynomial that its source announced; else it interpolates between both ends of the
    step or extrapolates from its beginning, as the algorithm has it. Its degree follows from the derivatives that
    source and target can handle.

    Every run ends by terminating the slaves. A failing slave doesn't raise: the outcome tells, and the recording holds
    everything up to the last completed step.

    Args:
        system: slaves and connections.
        stop, start: [s].
        step: communication step [s]; with step control the first one.
        tolerance: relative tolerance for the slaves' own integrators; None for their default.
        progress: called now and then with the simulated fraction.
        algorithm: how slaves are coupled over a step: `GaussSeidel` (when None), `Jacobi` or `Implicit`.
        step_control: chooses the communication steps; None for a constant step.
        compiled: True or None to run the loop over the points in C where the system allows it (no steps are repeated)
            and there is a C compiler, False for Python; the numbers are the same.

    Raises:
        InputError: the time grid makes no sense, a sample time doesn't fit it, or a slave would have to be taken back to
            an earlier state but can't.
    """
    chosen = GaussSeidel() if algorithm is None else algorithm
    clocks = [Clock(s.name, s.sample_time, offset(s)) for s in system.slaves if isinstance(s, Sampled)]
    marks = [mark for slave in system.slaves if isinstance(slave, HasBreakpoints) for mark in slave.breakpoints]
    grid = time_grid(start, stop, step, marks, clocks, ticks=step_control is None)
    schedule = Schedule(system, grid, chosen)
    run = Run(schedule, grid, progress, None if compiled is False else load())
    if step_control is not None:
        check_can_save(revocable(system.slaves), "step control")
        error = CouplingError(system, schedule.outputs, schedule.couplings, step_control, stop - start)
        run.control_steps(step_control, error, step)
    return _result(system, schedule, run, _completed(system, run, tolerance))


def _completed(system: System, run: Run, tolerance: float | None) -> BaseException | None:
    """Let it run and terminate the slaves; what went wrong, if anything."""
    try:
        run.go(tolerance)
    except (Exception, KeyboardInterrupt) as failure:
        return failure
    finally:
        for slave in system.slaves:
            if isinstance(slave, Terminates):
                slave.terminate()
    return None


def _result(system: System, schedule: Schedule, run: Run, error: BaseException | None) -> Simulation:
    """What the run gave."""
    recording, reached = run.recorder.recording(), run.reached
    outcome = _outcome(error, run.initialized)
    message = _message(error, outcome, schedule.activity.name, reached.time)
    blown_up = None if outcome is Outcome.INTERRUPTED else _instability(system, schedule, recording)
    if blown_up is not None:
        outcome, message = Outcome.COUPLING_UNSTABLE, _blown_up(blown_up, message if error is not None else "")
    delays = signal_delays(system, schedule.couplings, reached.largest_step)
    return Simulation(recording, outcome, message, error, reached.steps, reached.rejected, delays)


def _outcome(error: BaseException | None, initialized: bool) -> Outcome:
    """How the run ended."""
    if error is None:
        return Outcome.COMPLETED
    if isinstance(error, KeyboardInterrupt):
        return Outcome.INTERRUPTED
    kinds = {
        LoopError: Outcome.LOOP_NOT_SOLVED,
        StepSizeError: Outcome.STEP_TOO_SMALL,
        NotFiniteError: Outcome.NOT_FINITE,
    }
    other = Outcome.STEP_FAILED if initialized else Outcome.INITIALISATION_FAILED
    return next((kind for error_type, kind in kinds.items() if isinstance(error, error_type) and initialized), other)


def _message(error: BaseException | None, outcome: Outcome, active: str, reached: float) -> str:
    """What happened, in one line."""
    if error is None or isinstance(error, KeyboardInterrupt):
        return outcome.value
    if isinstance(error, LoopError | StepSizeError):
        return " ".join(str(error).split())
    slave = error.slave if isinstance(error, SlaveError) else active
    reason = error.reason if isinstance(error, SlaveError) else f"{type(error).__name__}: {error}"
    known: float | None = getattr(error, "time", None)
    when = f" at {reached if known is None else known:.9g} s"
    return f"{slave} failed{'' if when in reason else when}: {' '.join(reason.split())}"


def _instability(system: System, schedule: Schedule, recording: Recording) -> Instability | None:
    """What blew up among the signals that slaves feed each other, where some of them are extrapolated."""
    feedback = feedback_signals(system)
    if all(schedule.couplings[each.source, each.target].transport is not Transport.EXTRAPOLATED for each in feedback):
        return None
    names = dict.fromkeys(system.source_name(each) for each in feedback)
    return find_instability(recording.time, ((name, recording[name].values) for name in names))


def _blown_up(found: Instability, ending: str) -> str:
    """What happened, in one line."""
    return (
        f"{found.signal} grows {found.growth:.3g}-fold from step to step since {found.since:.9g} s: the coupling is unstable "
        f"(or the step far too coarse for the system); take a smaller communication step, Implicit() coupling, or slaves "
        f"with input and output derivatives{'; in the end ' + ending if ending else ''}"
    )
