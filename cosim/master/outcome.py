"""What a simulation gave, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from flexfmu.cosim.master.delays import SignalDelay
from flexfmu.cosim.results import Recording


class Outcome(Enum):
    """How a simulation ended; the value is a sentence for people."""

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
        """Whether the run came to no normal end."""
        return self not in (Outcome.COMPLETED, Outcome.ENDED_BY_SLAVE)


@dataclass(frozen=True)
class Simulation:
    """What a run gave.

    Attributes:
        recording: all outputs, named ``slave.variable``, up to where the run came.
        outcome: how it ended.
        message: what happened, in one line: which slave, when, and its own words.
        error: the exception that ended the run; None when it came to its stop time, or a slave asked to end it.
        steps: completed communication steps.
        rejected: steps that step control took back and repeated with a smaller one.
        delays: for each connection how late its signals arrive.
    """

    recording: Recording
    outcome: Outcome
    message: str
    error: BaseException | None
    steps: int
    rejected: int
    delays: tuple[SignalDelay, ...]

    @property
    def delay_report(self) -> str:
        """The delays in words, one line per connection."""
        return "\n".join(map(str, self.delays))
