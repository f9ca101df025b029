"""How a run ended, in a word and in a sentence."""

from __future__ import annotations

from collections.abc import Iterable

from flexfmu.cosim.errors import LoopError, NotFiniteError, SlaveEnded, SlaveError, StepSizeError, WorkError
from flexfmu.cosim.master.outcome import Outcome
from flexfmu.cosim.master.stability import Instability


def outcome_of(error: BaseException | None, initialized: bool) -> Outcome:
    """How the run ended."""
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
    other = Outcome.STEP_FAILED if initialized else Outcome.INITIALISATION_FAILED
    return next((kind for error_type, kind in kinds.items() if isinstance(error, error_type) and initialized), other)


def message_of(error: BaseException | None, outcome: Outcome, active: str, reached: float) -> str:
    """What happened, in one line."""
    if error is None or isinstance(error, KeyboardInterrupt):
        return outcome.value
    if isinstance(error, LoopError | StepSizeError | WorkError):
        return " ".join(str(error).split())
    slave = error.slave if isinstance(error, SlaveError) else active
    reason = error.reason if isinstance(error, SlaveError) else f"{type(error).__name__}: {error}"
    if isinstance(error, SystemExit):
        reason = (
            f"it called sys.exit({'' if error.code is None else repr(error.code)}); raise an exception to end a run"
        )
    known: float | None = getattr(error, "time", None)
    when = f" at {reached if known is None else known:.9g} s"
    if outcome is Outcome.ENDED_BY_SLAVE:
        return f"{slave} asked to end the simulation{when}: {' '.join(reason.split())}"
    return f"{slave} failed{'' if when in reason else when}: {' '.join(reason.split())}"


def blown_up(found: Instability, ending: str) -> str:
    """What happened, in one line."""
    return (
        f"{found.signal} grows {found.growth:.3g}-fold from step to step since {found.since:.9g} s: the coupling is unstable "
        f"(or the step far too coarse for the system); take a smaller communication step, Implicit() coupling, or slaves "
        f"with input and output derivatives{'; in the end ' + ending if ending else ''}"
    )


def overshot(found: Instability, fed: Iterable[str], ending: str) -> str:
    """What happened, in one line.

    Args:
        found: the signal.
        fed: names of the slaves that it goes to.
        ending: how the run ended; empty if it came to its stop time.
    """
    return (
        f"{found.signal}, which goes to {', '.join(fed)}, jumps up and down {found.growth:.3g} times as far from step to step "
        f"since {found.since:.9g} s: the coupling is unstable; lower the gain of the loop, or take a smaller communication "
        f"step and sample time{'; in the end ' + ending if ending else ''}"
    )
