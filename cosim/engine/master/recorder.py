"""Records signals during a run, in buffers that grow; they stay valid if the run fails.

With shared memory the parent process sees what a child process records, even if the child crashes.
"""

from __future__ import annotations

import mmap
import os
import weakref
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.ports import OutputPort
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import TEXTS, RealArray

_MADV_POPULATE_WRITE = 23
"""MADV_POPULATE_WRITE of Linux 5.14 and later; Python's mmap has no name for it."""


SPEND_LESS = "take a larger communication step or sample time, a shorter run, or in Python record fewer signals: PreparedScene(scene, record=Selection(..))"


class Recorder:
    """Copies the signals of output ports, instant by instant.

    Args:
        ports: output ports to record.
        capacity: expected number of instants; the buffers grow if there are more.
        shared: whether child processes record into the same memory.

    Attributes:
        values: expected number of recorded values.
        time: (capacity,) recorded instants [s]; NaN beyond the last one.
        blocks: for each port its current signals (orders + 1, n) and the recorded ones (capacity, orders + 1, n).

    Raises:
        InputError: there is not enough memory for the expected values.
    """

    def __init__(self, ports: Sequence[OutputPort], capacity: int, *, shared: bool = False) -> None:
        # names and units of the columns
        signals = [(port.slave.name, [port.slave.variables[i] for i in port.indices]) for port in ports]
        self._names = [[f"{slave}.{each.name}" for each in variables] for slave, variables in signals]
        self._texts = [[each.type == "String" for each in variables] for _, variables in signals]
        self._units = [[each.unit for each in variables] for _, variables in signals]
        self._signals = [port.signals[: port.recorded] for port in ports]
        self._count = 0
        # allocate memory for all instants at once
        self.values = capacity * sum(signals.size for signals in self._signals)
        self._memories = [_Memory(shape, shared) for shape in (*(signals.shape for signals in self._signals), ())]
        try:
            self._enlarge(max(capacity, 1))
        except (MemoryError, OSError):
            raise InputError(
                f"{self.values:.3g} values at {capacity:.3g} instants are {8e-9 * self.values:.3g} GB, more than there is; "
                f"{SPEND_LESS}"
            ) from None
        self.time.fill(np.nan)

    def append(self, time: float) -> None:
        """Record the current signals of all ports at ``time`` [s]."""
        if self._count == self.time.size:
            self._enlarge(2 * self._count)
            self.time[self._count :] = np.nan
        for signals, rows in self.blocks:
            rows[self._count] = signals
        self.time[self._count] = time
        self._count += 1

    @property
    def count(self) -> int:
        """Number of recorded instants."""
        return self._count

    def advance(self, count: int) -> None:
        """Set the number of recorded instants to ``count``, after C has written them into ``time`` and ``blocks``."""
        self._count = count

    def rewind(self, count: int) -> None:
        """Delete all instants but the first ``count``: those of a rejected step, or with 0 those of an earlier run."""
        self.time[count : self._count] = np.nan
        self._count = count

    def catch_up(self) -> int:
        """Update the count with the instants that a child process has recorded, and return it."""
        if (capacity := self._memories[-1].capacity) > self.time.size:
            self._enlarge(capacity)
        self._count = int(np.searchsorted(self.time, np.nan))
        return self._count

    def recording(self) -> Recording:
        """A copy of all signals recorded so far, named ``slave.variable``."""
        columns: dict[str, Column] = {}
        for names, units, texts, rows in zip(self._names, self._units, self._texts, self._rows, strict=True):
            # values and derivatives, signal by signal; texts are recorded as codes
            known = TEXTS.known() if any(texts) else []
            signals = rows[: self._count].transpose(2, 1, 0).copy()
            for name, unit, text, signal in zip(names, units, texts, signals, strict=True):
                columns[name] = Column(unit, signal[0], texts=known) if text else Column(unit, *signal)
        return Recording(self.time[: self._count].copy(), columns)

    def populate(self) -> None:
        """Map all shared memory at once, which is faster than page by page; call it in the process that records."""
        for memory in self._memories:
            memory.populate()

    def _enlarge(self, capacity: int) -> None:
        """Enlarge all buffers to ``capacity`` instants."""
        *self._rows, self.time = (memory.enlarge(capacity) for memory in self._memories)
        self.blocks = list(zip(self._signals, self._rows, strict=True))


class _Memory:
    """A growing buffer of rows of this shape; if shared, an anonymous file that grows for all processes."""

    def __init__(self, shape: tuple[int, ...], shared: bool) -> None:
        self._shape, self._file, self._rows = shape, -1, np.empty((0, *shape))
        self._map: mmap.mmap | None = None
        self._row_bytes = max(8 * int(np.prod(shape)), 1)
        if shared:
            self._file = os.memfd_create("flexfmu recording")
            weakref.finalize(self, os.close, self._file)

    @property
    def capacity(self) -> int:
        """Number of rows that fit in; another process may have enlarged a shared buffer."""
        return len(self._rows) if self._file < 0 else os.fstat(self._file).st_size // self._row_bytes

    def enlarge(self, capacity: int) -> RealArray:
        """The rows (capacity, ...); they begin with the previous ones."""
        if self._file < 0:
            rows = np.empty((capacity, *self._shape))
            rows[: len(self._rows)] = self._rows
        else:
            # enlarge the file for all processes and map it again
            size = capacity * self._row_bytes
            if size > os.fstat(self._file).st_size:
                os.ftruncate(self._file, size)
            self._map = mmap.mmap(self._file, size)
            rows = np.ndarray((capacity, *self._shape), buffer=self._map)
        self._rows = rows
        return rows

    def populate(self) -> None:
        """Map all pages, if the kernel supports it and there is enough memory."""
        if self._map is not None:
            with suppress(OSError):
                self._map.madvise(_MADV_POPULATE_WRITE)
