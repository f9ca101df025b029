"""What FMUs log, collected per instance, so that an error carries the FMU's own sentence."""

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
"""Messages kept per instance; a chatty FMU must not fill the memory."""

MAXIMUM_COMPLAINTS = 3
"""An FMU that explains a failure at several levels needs no more lines than this."""


class FmuLog:
    """Messages of one instance at a time, oldest first.

    Attributes:
        messages: what the FMU said with status warning or worse.
        callbacks: the structure for fmi2Instantiate; must live as long as the instance.
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
        """Forget the messages of the instance before and receive those of the next one; fmpy's formatting proxy serves one
        listener at a time in a process."""
        self.messages.clear()
        self._complaints.clear()
        _logs[self._key] = self
        self.callbacks.logger = _logger
        addLoggerProxy(byref(self.callbacks))

    def close(self) -> None:
        """Receive no more."""
        _logs.pop(self._key, None)

    def complaint(self) -> str:
        """The last messages that came with a failure, as one line; empty when the FMU fails without a word."""
        return "; ".join(dict.fromkeys(self._complaints))

    def add(self, status: int, message: str) -> None:
        """Keep a message that matters."""
        line = " ".join(message.split())
        if status >= WARNING and len(self.messages) < MAXIMUM_MESSAGES:
            self.messages.append(line)
        if status > WARNING:
            self._complaints.append(line)


_logs: dict[int, FmuLog] = {}
_keys = count(1)


def _receive(environment: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
    """Hand a message to the instance it belongs to, or print it if it is a foreign one's."""
    text = (message or b"").decode("utf-8", "replace")
    log = _logs.get(environment or 0)
    if log is not None:
        log.add(status, text)
    elif status >= WARNING:
        print(f"{(name or b'').decode('utf-8', 'replace')}: {text}", file=sys.stderr)


_logger = fmi2CallbackLoggerTYPE(_receive)
_allocate = fmi2CallbackAllocateMemoryTYPE(calloc)
_free = fmi2CallbackFreeMemoryTYPE(free)
