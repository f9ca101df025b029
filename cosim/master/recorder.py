"""Records signals during a run, in buffers that grow; what has been recorded stays, whatever happens next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from flexfmu.cosim.master.ports import OutputPort
from flexfmu.cosim.results import Column, RealArray, Recording


class Recorder:
    """Copies the signals of output ports, instant by instant.

    Args:
        ports: what to record.
        capacity: expected number of instants; more are possible.

    Attributes:
        time: (capacity,) recorded instants [s].
        blocks: for each port its present signals (orders + 1, n) and the recorded ones (capacity, orders + 1, n).
    """

    def __init__(self, ports: Sequence[OutputPort], capacity: int) -> None:
        self._signals = [
            [
                (f"{p.slave.name}.{variable.name}", variable.unit)
                for variable in map(p.slave.variables.__getitem__, p.indices)
            ]
            for p in ports
        ]
        self._count = 0
        self.time = np.empty(max(capacity, 1))
        self._rows = [np.empty((self.time.size, port.recorded, port.indices.size)) for port in ports]
        self.blocks = [(port.signals[: port.recorded], rows) for port, rows in zip(ports, self._rows, strict=True)]

    def append(self, time: float) -> None:
        """Record the current signals of all ports."""
        if self._count == self.time.size:
            self._grow()
        for signals, rows in self.blocks:
            rows[self._count] = signals
        self.time[self._count] = time
        self._count += 1

    @property
    def count(self) -> int:
        """How many instants have been recorded."""
        return self._count

    def advance(self, count: int) -> None:
        """Take note of ``count`` instants in all, which somebody has put into ``time`` and ``blocks``."""
        self._count = count

    def rewind(self, count: int) -> None:
        """Forget all instants but the first ``count``, of a step that was rejected."""
        self._count = count

    def recording(self) -> Recording:
        """Everything recorded so far, named ``slave.variable``."""
        columns = {
            name: column
            for signals, rows in zip(self._signals, self._rows, strict=True)
            for name, column in _columns(signals, rows[: self._count])
        }
        return Recording(self.time[: self._count].copy(), columns)

    def _grow(self) -> None:
        """Double the capacity."""
        self.time = np.concatenate([self.time, np.empty_like(self.time)])
        self._rows = [np.concatenate([rows, np.empty_like(rows)]) for rows in self._rows]
        self.blocks = [(signals, rows) for (signals, _), rows in zip(self.blocks, self._rows, strict=True)]


def _columns(signals: Sequence[tuple[str, str]], rows: RealArray) -> Iterator[tuple[str, Column]]:
    """Columns of signals, which have names and units, from their rows (N, orders + 1, n)."""
    by_order = rows.transpose(1, 2, 0).copy()
    nothing = [None] * len(signals)
    first, second = (by_order[order] if order < len(by_order) else nothing for order in (1, 2))
    for (name, unit), *values in zip(signals, by_order[0], first, second, strict=True):
        yield name, Column(unit, *values)
