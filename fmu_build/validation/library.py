"""The functions of an FMU's library: each call is watched, so that a finding about a hang or a crash names the call.

Memory that the FMU fills lies between guards, so that a write beyond its end is seen.
"""

from __future__ import annotations

import sys
from collections import Counter
from contextlib import suppress
from time import monotonic
from typing import Any, ClassVar

from fmpy import fmi2

GUARD = bytes(range(0xA0, 0xC0))
"""What lies before and behind each block of memory that an FMU gets, to see whether it writes there."""

CANARY = -4.25e11
"""What lies behind an array that the FMU fills."""

_WARNING = 1
"""fmi2Warning."""

TRY = "flexfmu tries:"
"""Prefix of the lines on standard error that say what is tried, in case the FMU crashes."""


def announce(what: str) -> None:
    """Say what is tried next."""
    with suppress(OSError):  # an FMU may have closed it
        print(f"{TRY}{what}", file=sys.stderr, flush=True)


class MisbehaviourError(RuntimeError):
    """An FMU doesn't do what the standard demands.

    Attributes:
        remedy: what would be right.
    """

    def __init__(self, message: str, remedy: str) -> None:
        super().__init__(message)
        self.remedy = remedy


class Watch:
    """Which FMI call is under way, and since when; another thread may look. How often functions were called, and warned."""

    call = ""
    since = 0.0
    calls: ClassVar[Counter[str]] = Counter()
    warnings: ClassVar[Counter[str]] = Counter()


class _Watched:
    """Reports each call to `Watch`."""

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
    """The functions for co-simulation; fmpy looks at the beginning of the class's name."""


class FMU2ModelLibrary(_Watched, fmi2.FMU2Model):  # type: ignore[misc]
    """The functions for model exchange."""


def is_guarded(block: Any) -> bool:
    """Whether the guards of a block are as they were."""
    content = bytes(memoryview(block))
    return content.startswith(GUARD) and content.endswith(GUARD)
