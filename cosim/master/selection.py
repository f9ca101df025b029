"""Which signals a run keeps: what nobody asks for and no slave is fed with is not even read."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from difflib import get_close_matches

from flexfmu.cosim.errors import InputError
from flexfmu.cosim.results import Recording


@dataclass(frozen=True)
class Selection:
    """What is recorded.

    Attributes:
        names: signals to keep, named as in the recording; None for all.
        order: highest time derivative to keep, 0 (values alone) to 2; metrics need 2, since they are taken from the
            continuous solution between the communication points.

    Raises:
        InputError: the order is none of these.
    """

    names: Collection[str] | None = None
    order: int = 2

    def __post_init__(self) -> None:
        if self.order not in (0, 1, 2):
            raise InputError(f"derivatives are recorded up to order 0, 1 or 2, got {self.order!r}")
        if isinstance(self.names, str):
            raise InputError(f"the signals to record must be a list of names, got the single text {self.names!r}")

    def keeps(self, name: str) -> bool:
        """Whether a signal is kept."""
        return self.names is None or name in self.names

    def of(self, recording: Recording) -> Recording:
        """What is kept of a recording."""
        return recording if self.names is None else recording.only(self.keeps)

    def check(self, known: Collection[str]) -> None:
        """Look for all names among those that there are.

        Raises:
            InputError: there is no such signal.
        """
        for name in self.names or ():
            if name not in known:
                near = get_close_matches(name, known, n=1, cutoff=0.0)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise InputError(f"there is no signal {name!r} to record{hint}")


EVERYTHING = Selection()
