"""Log messages of FMUs, collected per instance, so that errors quote the FMU's own message."""

from __future__ import annotations

import sys
from collections import deque
from ctypes import byref
from itertools import count
from typing import Any

from fmpy import calloc, free
from fmpy.fmi2 import (
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.logging import addLoggerProxy

from flexfmu.cosim.engine.fmu.calls import WARNING

MAXIMUM_MESSAGES = 200
"""Messages kept per instance; a verbose FMU must not fill the memory."""

MAXIMUM_COMPLAINTS = 3
"""Last messages of a failure that an error quotes."""


class FmuLog:
    """Log of one instance at a time.

    Attributes:
        messages: messages with status warning or worse, oldest first.
        callbacks: callback structure for fmi2Instantiate; must exist as long as the instance.
    """

    def __init__(self) -> None:
        self.messages: list[str] = []
        self._complaints: deque[str] = deque(maxlen=MAXIMUM_COMPLAINTS)
        self._key = next(_keys)
        self.callbacks: Any = fmi2CallbackFunctions()
        self.callbacks.allocateMemory = _allocate
        self.callbacks.freeMemory = _free
        self.callbacks.componentEnvironment = self._key

    def open(self) -> None:
        """Clear the messages and receive those of the next instance.

        fmpy's logger proxy, which formats messages, serves one logger at a time in a process.
        """
        self.messages.clear()
        self._complaints.clear()
        _logs[self._key] = self
        self.callbacks.logger = _logger
        addLoggerProxy(byref(self.callbacks))

    def close(self) -> None:
        """Stop receiving messages."""
        _logs.pop(self._key, None)

    def complaint(self) -> str:
        """Return the last messages of a failure as one line; empty if the FMU gave none."""
        return "; ".join(dict.fromkeys(self._complaints))

    def add(self, status: int, message: str) -> None:
        """Keep a message with status warning or worse."""
        line = " ".join(message.split())
        if status >= WARNING and len(self.messages) < MAXIMUM_MESSAGES:
            self.messages.append(line)
        if status > WARNING:
            self._complaints.append(line)


_logs: dict[int, FmuLog] = {}
_keys = count(1)


def _receive(environment: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
    """Add a message to its instance's log; print it if the instance is unknown."""
    text = (message or b"").decode("utf-8", "replace")
    log = _logs.get(environment or 0)
    if log is not None:
        log.add(status, text)
    elif status >= WARNING:
        print(f"{(name or b'').decode('utf-8', 'replace')}: {text}", file=sys.stderr)


_logger = fmi2CallbackLoggerTYPE(_receive)
_allocate = fmi2CallbackAllocateMemoryTYPE(calloc)
_free = fmi2CallbackFreeMemoryTYPE(free)
