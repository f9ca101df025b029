"""Records signals during a run, column by column, in memory that becomes the result: nothing is copied at the end.

With shared memory the parent process sees what a child process records, even if the child crashes. A large recording is
mapped from a temporary file: the system writes it to disk during the run, and the process keeps only the pages in use.
"""

from __future__ import annotations

import mmap
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.ports import OutputPort
from flexfmu.cosim.engine.results import Column, LazyColumns, Recording, SignalTable
from flexfmu.cosim.engine.slave import TEXTS, RealArray, SlaveVariable

_MADV_POPULATE_WRITE = 23
"""MADV_POPULATE_WRITE of Linux 5.14 and later; Python's mmap has no name for it."""

LARGE = 2**27
"""Size of a recording [bytes] from which it is mapped from a temporary file, where the platform can reserve its space."""

RELEASED = 8192
"""Number of instants after which the pages of a file that they fill are released."""

LINE = 8
"""Numbers in a cache line. Columns are an odd number of lines apart, so that they don't compete for the same lines."""

SPEND_LESS = "take a larger communication step or sample time, a shorter run, or record fewer signals or less often: `cosimulation.record`, `record_step`"


class Recorder:
    """Copies the signals of output ports, instant by instant.

    Args:
        ports: output ports to record.
        capacity: expected number of instants; further memory is added if there are more.
        shared: whether child processes record into the same memory.
        keeps: whether a signal of that name is recorded.

    Attributes:
        values: expected number of recorded values.
        time: (capacity,) recorded instants [s] of the current part of the memory; NaN beyond the last one.
        blocks: current signals (n,) that are recorded into successive columns (n, capacity), and these columns.

    Raises:
        InputError: there is not enough memory for the expected values.
    """

    def __init__(
        self,
        ports: Sequence[OutputPort],
        capacity: int,
        *,
        shared: bool = False,
        keeps: Callable[[str], bool] = lambda name: True,
    ) -> None:
        # variables that are kept, by name, as indices in their port
        named = [
            [(f"{port.slave.name}.{(variable := port.slave.variables[i]).name}", variable) for i in port.indices]
            for port in ports
        ]
        self._kept = [[(i, *each) for i, each in enumerate(signals) if keeps(each[0])] for signals in named]
        self.places = _places(self._kept, [port.recorded for port in ports])
        self._texts = {name for kept in self._kept for _, name, variable in kept if variable.type == "String"}
        # current signals: runs of successive ones, order by order
        self._signals: list[RealArray] = []
        for port, kept in zip(ports, self._kept, strict=True):
            rows, places = port.signals[: port.recorded], np.array([i for i, *_ in kept], dtype=np.intp)
            if places.size == rows.shape[1]:
                self._signals.append(rows.reshape(-1))
                continue
            runs = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1) if places.size else []
            self._signals += [row[run[0] : run[-1] + 1] for row in rows for run in runs]
        self._shared = shared
        self._width = 1 + sum(signals.size for signals in self._signals)
        self.expect(capacity)

    def expect(self, capacity: int) -> None:
        """Delete all instants, and expect so many."""
        self._capacity, self.values = max(capacity, 1), capacity * (self._width - 1)
        self._begin()

    def _begin(self) -> None:
        """Allocate memory for all expected instants at once."""
        self._parts: list[RealArray] = []
        self._count = self._released = 0
        self._memory = _Memory(self._width, self._shared)
        try:
            self._add_part()
        except (MemoryError, OSError):
            raise InputError(
                f"{self.values:.3g} values at {self._capacity:.3g} instants are {8e-9 * self.values:.3g} GB, more than there "
                f"is; {SPEND_LESS}"
            ) from None
        self._own_references = self._references()

    def _add_part(self, *, fill: bool = True) -> None:
        """Add memory, a part as large as all before it together; a child process has filled it with NaN already."""
        before = sum(part.shape[1] for part in self._parts)
        self._parts.append(self._memory.part(max(before, self._capacity)))
        if fill:
            self._parts[-1][0].fill(np.nan)
        self._enter()

    def _enter(self) -> None:
        """Make the last part of the memory the current one."""
        part, place = self._parts[-1], 1
        self.time, self._first = part[0], sum(each.shape[1] for each in self._parts[:-1])
        self.blocks = []
        for signals in self._signals:
            self.blocks.append((signals, part[place : place + signals.size]))
            place += signals.size

    def append(self, time: float) -> None:
        """Record the current signals of all ports at ``time`` [s]."""
        if self._count == self._first + self.time.size:
            self._add_part()
        place = self._count - self._first
        for signals, columns in self.blocks:
            columns[:, place] = signals
        self.time[place] = time
        self.advance(self._count + 1)

    @property
    def count(self) -> int:
        """Number of recorded instants."""
        return self._count

    @property
    def times(self) -> RealArray:
        """(count,) recorded instants [s]; a copy only if step control has needed several parts of memory."""
        pieces = [part[0] for part in self._parts]
        return pieces[0][: self._count] if len(pieces) == 1 else np.concatenate(pieces)[: self._count]

    @property
    def last(self) -> float:
        """The last recorded instant [s]; one must have been recorded."""
        return float(self.time[self._count - 1 - self._first])

    def advance(self, count: int) -> None:
        """Set the number of recorded instants to ``count``, after C has written them into ``time`` and ``blocks``."""
        self._count = count
        # release what is full; step control may rewind a few instants, which are then loaded again
        if count - self._released > RELEASED:
            self._memory.release(self._released - self._first, count - self._first)
            self._released = count

    def rewind(self, count: int) -> None:
        """Delete all instants but the first ``count``: those of a rejected step, or with 0 those of an earlier run."""
        is_in_use = self._references() > self._own_references  # by a recording, or an array of one
        if count == 0 and (is_in_use or len(self._parts) > 1):
            self._begin()
            return
        while self._first > count:
            self._parts.pop()
            self._enter()
        self.time[count - self._first : self._count - self._first] = np.nan
        self._count, self._released = count, min(count, self._released)

    def catch_up(self) -> int:
        """Update the count with the instants that a child process has recorded, and return it."""
        while self._memory.is_extended:
            self._add_part(fill=False)
        self._count = self._first + int(np.searchsorted(self.time, np.nan))
        return self._count

    def recording(self) -> Recording:
        """All signals recorded so far, named ``slave.variable``.

        They use the recorder's memory; the next run has new memory, unless they are no longer in use.
        """
        self._own_references = min(self._own_references, self._references())
        rows, places = self._rows(), self.places

        def column(name: str) -> Column:
            unit, own = places[name]
            # texts are recorded as codes
            if name in self._texts:
                return Column(unit, rows[own[0]], texts=TEXTS.known())
            return Column(unit, *(rows[i] for i in own))

        return Recording(rows[0], LazyColumns(places, column, SignalTable(rows, places)))

    def _references(self) -> int:
        """Number of references to the memory, those of its views included."""
        return sum(sys.getrefcount(part) for part in self._parts)

    def populate(self) -> None:
        """Map all shared memory at once, which is faster than page by page; call it in the process that records."""
        self._memory.populate()

    def _rows(self) -> RealArray:
        """All columns as rows (n, count), time first; a copy only if step control has needed several parts of memory."""
        if len(self._parts) == 1:
            return self._parts[0][:, : self._count]
        return np.concatenate(self._parts, axis=1)[:, : self._count]


Kept = Sequence[tuple[int, str, SlaveVariable]]
"""Recorded signals of a port: index, name and variable."""


def _places(ports: Sequence[Kept], orders: Sequence[int]) -> dict[str, tuple[str, range]]:
    """Name of a signal → its unit, and its rows in the memory: value and derivatives, one for texts."""
    found, place = {}, 1
    for kept, count in zip(ports, orders, strict=True):
        end = place + count * len(kept)
        for i, (_, name, variable) in enumerate(kept, place):
            found[name] = variable.unit, range(i, i + 1 if variable.type == "String" else end, len(kept))
        place = end
    return found


class _Memory:
    """Memory for columns, part by part: in this process, or in an unnamed file that is shared or large.

    The file disappears with its last mapping: with the arrays, or with the process.
    """

    def __init__(self, width: int, shared: bool) -> None:
        self._width, self._shared, self._file, self._end = width, shared, -1, 0
        self._map: mmap.mmap | None = None
        self._row_bytes = 0
        self._is_large = False

    def __del__(self) -> None:
        if self._file >= 0:
            os.close(self._file)

    def part(self, capacity: int) -> RealArray:
        """A further part (width, capacity), the capacity rounded up; in a shared file perhaps one of a child process."""
        lines = -(-capacity // LINE)
        capacity = LINE * (lines + 1 - lines % 2)
        size = 8 * self._width * capacity
        if self._file < 0 and not self._open(size):
            return np.empty((self._width, capacity))
        # space in the file, at a place where it can be mapped
        begin, granularity = self._end, mmap.ALLOCATIONGRANULARITY
        self._end = begin + -(-size // granularity) * granularity
        if self._is_large:
            os.posix_fallocate(self._file, begin, self._end - begin)
        elif os.fstat(self._file).st_size < self._end:
            os.ftruncate(self._file, self._end)
        self._map, self._row_bytes = mmap.mmap(self._file, self._end - begin, offset=begin), 8 * capacity
        return np.ndarray((self._width, capacity), buffer=self._map)

    def _open(self, size: int) -> bool:
        """Open a file for a first part of this size [bytes]; False if the part is allocated in this process."""
        if size >= LARGE and hasattr(os, "posix_fallocate"):
            # reserve the space: without it the run would crash later
            with suppress(OSError), tempfile.TemporaryFile(prefix="flexfmu-") as file:
                os.posix_fallocate(file.fileno(), 0, size)
                self._file, self._is_large = os.dup(file.fileno()), True
                return True
        if self._shared:
            self._file = os.memfd_create("flexfmu recording")
        return self._shared

    @property
    def is_extended(self) -> bool:
        """Whether a child process has added a part that isn't mapped here."""
        return self._file >= 0 and os.fstat(self._file).st_size > self._end

    def release(self, begin: int, end: int) -> None:
        """Release the pages of a large file with the instants from ``begin`` to ``end``, both from the part's first."""
        if self._map is None or not self._is_large or not hasattr(mmap, "MADV_DONTNEED"):
            return
        page = mmap.PAGESIZE
        for column in range(self._width):
            start, stop = (column * self._row_bytes + 8 * each for each in (max(begin, 0), end))
            start, stop = start // page * page, stop // page * page
            if stop > start:
                self._map.madvise(mmap.MADV_DONTNEED, start, stop - start)

    def populate(self) -> None:
        """Map all pages of memory shared with a child process, if the kernel supports it and there is enough memory."""
        if self._map is not None and not self._is_large:
            with suppress(OSError):
                self._map.madvise(_MADV_POPULATE_WRITE)
