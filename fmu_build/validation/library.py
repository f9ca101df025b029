"""The functions of an FMU's shared library, with a record of the current call, so that findings about hangs name it.

Guards around memory that the FMU fills detect writes beyond its bounds.
"""

from __future__ import annotations

import sys
from collections import Counter
from contextlib import suppress
from time import monotonic
from typing import Any, ClassVar

from fmpy import fmi2

GUARD = bytes(range(0xA0, 0xC0))
"""Bytes before and behind each block of memory that an FMU gets; a change reveals a write out of bounds."""

CANARY = -4.25e11
"""Value behind an array of doubles that the FMU fills; a change reveals a write out of bounds."""

_WARNING = 1
"""fmi2Warning."""

TRY = "flexfmu tries:"
"""Prefix of announcements on standard error, which name the current action if the FMU crashes."""


def announce(what: str) -> None:
    """Announce the next action on standard error."""
    with suppress(OSError):  # an FMU may have closed it
        print(f"{TRY}{what}", file=sys.stderr, flush=True)


class MisbehaviourError(RuntimeError):
    """An FMU violates the standard.

    Attributes:
        remedy: what to do.
    """

    def __init__(self, message: str, remedy: str) -> None:
        super().__init__(message)
        self.remedy = remedy


class Watch:
    """Record of the FMI calls of this process, read by the watchdog thread.

    Attributes:
        call: name of the current call; empty if there is none.
        since: its start, by `time.monotonic` [s].
        calls: function → number of calls.
        warnings: function → number of calls that returned fmi2Warning.
    """

    call = ""
    since = 0.0
    calls: ClassVar[Counter[str]] = Counter()
    warnings: ClassVar[Counter[str]] = Counter()


class _Watched:
    """Records each call in `Watch`."""

    def _call(self, name: str, *arguments: Any) -> Any:
        Watch.since = monotonic()
        Watch.call = name
        Watch.calls[name] += 1
        try:
            status = super()._call(name, *arguments)  # type: ignore[misc]
            Watch.warnings[name] += status == _WARNING
            return status
        finally:
            Watch.call = ""


class FMU2SlaveLibrary(_Watched, fmi2.FMU2Slave):  # type: ignore[misc]
    """The functions for co-simulation; fmpy evaluates the prefix of the class name."""


class FMU2ModelLibrary(_Watched, fmi2.FMU2Model):  # type: ignore[misc]
    """The functions for model exchange."""


def is_guarded(block: Any) -> bool:
    """Whether the guards of a block are unchanged."""
    content = bytes(memoryview(block))
    return content.startswith(GUARD) and content.endswith(GUARD)
