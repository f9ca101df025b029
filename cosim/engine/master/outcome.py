"""The result of a simulation: its outcome, a message in one line, and the recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from flexfmu.cosim.engine.errors import LoopError, NotFiniteError, SlaveEnded, SlaveError, StepSizeError, WorkError
from flexfmu.cosim.engine.master.delays import SignalDelay
from flexfmu.cosim.engine.master.stability import Instability
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.showing import few_lines, shorten


class Outcome(Enum):
    """How a simulation ended; the value is a sentence for users."""

    COMPLETED = "the simulation reached its stop time"
    ENDED_BY_SLAVE = "a slave asked to end the simulation; the results end there"
    INITIALISATION_FAILED = "a slave could not be initialised; check its parameters and start values"
    STEP_FAILED = "a slave failed within a communication step; the results end before it"
    NOT_FINITE = "a slave's output became infinite or not a number; the results end before it"
    LOOP_NOT_SOLVED = "a loop of signals was not solved by its iteration; the results end before it"
    STEP_TOO_SMALL = "the smallest communication step doesn't keep the tolerance; the results end before it"
    TOO_MUCH_WORK = "the run took far more steps than its length allows; the results end where they led"
    COUPLING_UNSTABLE = "signals that go round between slaves grow faster than the communication step can resolve"
    LOOP_UNSTABLE = "the control loop is unstable; the results end where a slave could not follow any more"
    INTERRUPTED = "the simulation was interrupted; the results end there"

    @property
    def is_failure(self) -> bool:
        """Whether the run failed: neither its stop time nor a slave ended it."""
        return self not in (Outcome.COMPLETED, Outcome.ENDED_BY_SLAVE)


@dataclass(frozen=True, repr=False)
class Simulation:
    """Result of a run.

    Attributes:
        recording: the recorded outputs, named ``slave.variable``, up to the time that the run reached.
        outcome: how the run ended.
        message: what happened, in one line: the slave, the time, and the slave's message.
        error: the exception that ended the run; None if it reached its stop time or a slave asked to end it.
        steps: number of completed communication steps.
        rejected: number of steps that step control rolled back and repeated with a smaller length.
        delays: the delay of each connection.
    """

    recording: Recording
    outcome: Outcome
    message: str
    error: BaseException | None
    steps: int
    rejected: int
    delays: tuple[SignalDelay, ...]

    def __repr__(self) -> str:
        """Return at most five lines: how it went, and what was recorded."""
        head = f"Simulation: {self.steps} steps, {shorten(self.message, 50)}"
        return few_lines(f"{head}; recorded:", [*self.recording.columns])

    @property
    def delay_report(self) -> str:
        """The delays in words, one line per connection."""
        return "\n".join(map(str, self.delays))


def outcome_of(error: BaseException | None, initialized: bool) -> Outcome:
    """The outcome of a run that ended with this error.

    Args:
        error: the exception; None if the run reached its stop time.
        initialized: whether all slaves had been initialised.
    """
    if error is None:
        return Outcome.COMPLETED
    if isinstance(error, KeyboardInterrupt):
        return Outcome.INTERRUPTED
    kinds = {
        LoopError: Outcome.LOOP_NOT_SOLVED,
        StepSizeError: Outcome.STEP_TOO_SMALL,
        WorkError: Outcome.TOO_MUCH_WORK,
        NotFiniteError: Outcome.NOT_FINITE,
        SlaveEnded: Outcome.ENDED_BY_SLAVE,
    }
    # any other error, and any during initialisation
    other = Outcome.STEP_FAILED if initialized else Outcome.INITIALISATION_FAILED
    return next((kind for error_type, kind in kinds.items() if isinstance(error, error_type) and initialized), other)


def message_of(error: BaseException | None, outcome: Outcome, active: str, reached: float) -> str:
    """What happened, in one line.

    Args:
        error: the exception that ended the run, if any.
        outcome: of the run.
        active: name of the slave that was called last.
        reached: time that the run reached [s].
    """
    if error is None or isinstance(error, KeyboardInterrupt):
        return outcome.value
    if isinstance(error, LoopError | StepSizeError | WorkError):
        return " ".join(str(error).split())
    slave = error.slave if isinstance(error, SlaveError) else active
    reason = error.reason if isinstance(error, SlaveError) else f"{type(error).__name__}: {error}"
    if isinstance(error, SystemExit):
        # tblib, which Dask loads, makes errors pickle without their `code`
        code = repr(error.args[0]) if error.args else ""
        reason = f"it called sys.exit({code}); raise an exception to end a run"
    # the slave's own time, if it reports one
    known: float | None = getattr(error, "time", None)
    when = f" at {reached if known is None else known:.9g} s"
    if outcome is Outcome.ENDED_BY_SLAVE:
        return f"{slave} asked to end the simulation{when}: {' '.join(reason.split())}"
    return f"{slave} failed{'' if when in reason else when}: {' '.join(reason.split())}"


def blown_up(found: Instability, ending: str) -> str:
    """Message about a growing signal, in one line; ``ending`` is the message of the run's end, or empty."""
    return (
        f"{found.signal} grows {found.growth:.3g}-fold from step to step since {found.since:.9g} s: the coupling is unstable "
        f"(or the step far too coarse for the system); take a smaller communication step, Implicit() coupling, or slaves "
        f"with input and output derivatives{'; in the end ' + ending if ending else ''}"
    )


def overshot(found: Instability, fed: Iterable[str], ending: str) -> str:
    """Message about an alternating signal, in one line.

    Args:
        found: the signal.
        fed: names of the slaves that it feeds.
        ending: message of the run's end; empty if it reached its stop time.
    """
    return (
        f"{found.signal}, which goes to {', '.join(fed)}, jumps up and down {found.growth:.3g} times as far from step to step "
        f"since {found.since:.9g} s: the coupling is unstable; lower the gain of the loop, or take a smaller communication "
        f"step and sample time{'; in the end ' + ending if ending else ''}"
    )
