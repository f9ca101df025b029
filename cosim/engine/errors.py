"""Errors and warnings of a co-simulation; each message is one line with a remedy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches

from flexfmu.errors import Error

MOST_NAMES, NEAREST = 20, 5
"""Largest number of names that a message lists, and number of those nearest to a misspelt one where there are more."""


class CosimError(Error):
    """A run, its input or its results failed."""


class InputError(CosimError, ValueError):
    """The user's input is wrong (a file, a name or a value); nothing has been simulated."""


def suggestion(name: object, known: Iterable[str]) -> str:
    """What to write in place of an unknown name: the known one that it is close to, or else a list."""
    names = [*known]
    if near := get_close_matches(str(name), names, n=1):
        return f"did you mean {near[0]!r}?"
    if len(names) > MOST_NAMES:
        nearest = get_close_matches(str(name), names, n=NEAREST, cutoff=0.0)
        return f"there are: {', '.join(nearest)} and {len(names) - NEAREST} others"
    return f"there are: {', '.join(names) or 'none'}"


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Turn the failing import of an optional library in this context into one line.

    Args:
        name: the extra of the package that brings the library.

    Raises:
        InputError: the library isn't installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in ("", "flexfmu"):
            raise
        raise InputError(f'{missing} isn\'t installed; run: pip install "flexfmu[{name}]"') from None


class FmuFileError(InputError):
    """An FMU is missing, broken, or not made for this platform."""


class WiringError(InputError):
    """Slaves and connections don't fit together."""


class AlgebraicLoopError(WiringError):
    """Outputs and inputs depend on each other at the same instant, through direct feedthrough."""


class LoopError(CosimError):
    """The iteration of a loop of signals did not converge."""


class StepSizeError(CosimError):
    """Even at the smallest communication step the coupling error exceeds the tolerance."""


class WorkError(CosimError):
    """Step control takes far more steps than steps of the first step's length would need."""


class DataWarning(UserWarning):
    """A file of signals has values that are left out."""


class CostWarning(UserWarning):
    """A run will take a long time or much memory."""


class RunWarning(UserWarning):
    """A run ended before its stop time."""


class LoopWarning(UserWarning):
    """A control loop is unstable, or nearly."""


class LearningWarning(UserWarning):
    """What a controller learns makes errors grow from cycle to cycle."""


class ResultsError(CosimError):
    """Results can't be written or read."""


class SignalFileError(ResultsError, InputError):
    """A file of signals can't be read, or has something else."""


class SlaveWarning(UserWarning):
    """A slave can be used, but deviates from its description or from the values set."""


class SlaveError(CosimError):
    """A slave failed while it was initialised, stepped or read.

    Attributes:
        slave: the slave's name.
        reason: what happened; the slave's own message if it gave one.
        time: last time that the slave reached [s]; None if unknown.
    """

    def __init__(self, slave: str, reason: str, time: float | None = None) -> None:
        super().__init__(f"{slave}: {reason}")
        self.slave = slave
        self.reason = reason
        self.time = time

    def __reduce__(self) -> tuple[type[SlaveError], tuple[str, str, float | None]]:
        """Pickle the error by its own arguments, to send it to another process."""
        return type(self), (self.slave, self.reason, self.time)


class SlaveEnded(SlaveError):  # noqa: N818 - it isn't an error
    """A slave requests the end of the simulation, a normal end: fmi2Discard with fmi2Terminated, for example."""


class NotFiniteError(SlaveError):
    """An output is infinite or not a number."""
