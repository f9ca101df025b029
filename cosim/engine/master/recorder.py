"""Records signals during a run, in buffers that grow; what has been recorded stays, whatever happens next.

A recorder whose memory is shared sees what a child process records, also where that process comes to a sudden end.
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
"""Of Linux 5.14 and later."""


SPEND_LESS = "take a larger communication step or sample time, a shorter run, or in Python record fewer signals: PreparedScene(scene, record=Selection(..))"


class Recorder:
    """Copies the signals of output ports, instant by instant.

    Args:
        ports: what to record.
        capacity: expected number of instants; more are possible.
        shared: whether child processes record in the same memory.

    Attributes:
        values: how many numbers are expected.
        time: (capacity,) recorded instants [s], not a number behind them.
        blocks: for each port its present signals (orders + 1, n) and the recorded ones (capacity, orders + 1, n).
    """

    def __init__(self, ports: Sequence[OutputPort], capacity: int, *, shared: bool = False) -> None:
        # names and units of the columns
        signals = [(port.slave.name, [port.slave.variables[i] for i in port.indices]) for port in ports]
        self._names = [[f"{slave}.{each.name}" for each in variables] for slave, variables in signals]
        self._texts = [[each.type == "String" for each in variables] for _, variables in signals]
        self._units = [[each.unit for each in variables] for _, variables in signals]
        self._signals = [port.signals[: port.recorded] for port in ports]
        self._count = 0
        # room for all instants at once
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
        """Record the current signals of all ports."""
        if self._count == self.time.size:
            self._enlarge(2 * self._count)
            self.time[self._count :] = np.nan
        for signals, rows in self.blocks:
            rows[self._count] = signals
        self.time[self._count] = time
        self._count += 1

    @property
    def count(self) -> int:
        """How many instants have been recorded."""
        return self._count

    def advance(self, count: int) -> None:
        """Set the number of recorded instants to ``count``; the loop in C has written them into ``time`` and ``blocks``."""
        self._count = count

    def rewind(self, count: int) -> None:
        """Forget all instants but the first ``count``, of a step that was rejected."""
        self.time[count : self._count] = np.nan
        self._count = count

    def catch_up(self) -> int:
        """Take note of what a child process has recorded; how many instants in all."""
        if (capacity := self._memories[-1].capacity) > self.time.size:
            self._enlarge(capacity)
        self._count = int(np.searchsorted(self.time, np.nan))
        return self._count

    def recording(self) -> Recording:
        """Everything recorded so far, named ``slave.variable``."""
        columns: dict[str, Column] = {}
        for names, units, texts, rows in zip(self._names, self._units, self._texts, self._rows, strict=True):
            # values and derivatives of one signal after the other; of texts their codes
            known = TEXTS.known() if any(texts) else []
            signals = rows[: self._count].transpose(2, 1, 0).copy()
            for name, unit, text, signal in zip(names, units, texts, signals, strict=True):
                columns[name] = Column(unit, signal[0], texts=known) if text else Column(unit, *signal)
        return Recording(self.time[: self._count].copy(), columns)

    def populate(self) -> None:
        """Map all shared memory at once, which is cheaper than page by page; for a process that begins to record."""
        for memory in self._memories:
            memory.populate()

    def _enlarge(self, capacity: int) -> None:
        """Make room for so many instants."""
        *self._rows, self.time = (memory.enlarge(capacity) for memory in self._memories)
        self.blocks = list(zip(self._signals, self._rows, strict=True))


class _Memory:
    """Room for rows of that shape; shared memory is a file without a name, which grows in all processes."""

    def __init__(self, shape: tuple[int, ...], shared: bool) -> None:
        self._shape, self._file, self._rows = shape, -1, np.empty((0, *shape))
        self._map: mmap.mmap | None = None
        self._row_bytes = max(8 * int(np.prod(shape)), 1)
        if shared:
            self._file = os.memfd_create("flexfmu recording")
            weakref.finalize(self, os.close, self._file)

    @property
    def capacity(self) -> int:
        """Rows that there is room for; another process may have made more."""
        return len(self._rows) if self._file < 0 else os.fstat(self._file).st_size // self._row_bytes

    def enlarge(self, capacity: int) -> RealArray:
        """Rows (capacity, ...) that begin with those so far."""
        if self._file < 0:
            rows = np.empty((capacity, *self._shape))
            rows[: len(self._rows)] = self._rows
        else:
            # a file that grows for all processes, mapped anew
            size = capacity * self._row_bytes
            if size > os.fstat(self._file).st_size:
                os.ftruncate(self._file, size)
            self._map = mmap.mmap(self._file, size)
            rows = np.ndarray((capacity, *self._shape), buffer=self._map)
        self._rows = rows
        return rows

    def populate(self) -> None:
        """Map all pages, where the kernel can and there is memory enough."""
        if self._map is not None:
            with suppress(OSError):
                self._map.madvise(_MADV_POPULATE_WRITE)
