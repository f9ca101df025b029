"""What can go wrong in a co-simulation: one small family of errors, each a single line with its remedy."""

from __future__ import annotations


class CosimError(Exception):
    """Base of all errors of this package."""


class InputError(CosimError, ValueError):
    """The user's input is wrong: a file, a name, a value; nothing has been simulated."""


class FmuFileError(InputError):
    """An FMU is missing, broken, or not made for this platform."""


class WiringError(InputError):
    """Slaves and connections don't fit together."""


class AlgebraicLoopError(WiringError):
    """Outputs and inputs depend on each other without any state between them."""


class LoopError(CosimError):
    """A loop of signals could not be solved by iteration."""


class StepSizeError(CosimError):
    """Not even the smallest communication step keeps the error of the coupling that was asked for."""


class WorkError(CosimError):
    """A run takes far more work than its length allows."""


class CostWarning(UserWarning):
    """A run will take long, or much memory."""


class ResultsError(CosimError):
    """Results can't be written or read."""


class SlaveWarning(UserWarning):
    """A slave can be used, but does something else than it states or than was set."""


class SlaveError(CosimError):
    """A slave failed while it was initialised, stepped or read.

    Attributes:
        slave: the slave's name.
        reason: what happened, in the slave's own words where it has any.
        time: the last time that the slave reached [s]; None when it doesn't know.
    """

    def __init__(self, slave: str, reason: str, time: float | None = None) -> None:
        super().__init__(f"{slave}: {reason}")
        self.slave = slave
        self.reason = reason
        self.time = time

    def __reduce__(self) -> tuple[type[SlaveError], tuple[str, str, float | None]]:
        """For the way from one process to another."""
        return type(self), (self.slave, self.reason, self.time)


class SlaveEnded(SlaveError):  # noqa: N818 - it isn't an error
    """A slave asks to end the simulation, which is a normal end: fmi2Discard with fmi2Terminated, for example."""


class NotFiniteError(SlaveError):
    """An output is infinite or not a number."""
