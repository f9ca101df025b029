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
        signals = [(port.slave.name, [port.slave.variables[i] for i in port.indices]) for port in ports]
        self._names = [[f"{slave}.{each.name}" for each in variables] for slave, variables in signals]
        self._units = [[each.unit for each in variables] for _, variables in signals]
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
        columns: dict[str, Column] = {}
        for names, units, rows in zip(self._names, self._units, self._rows, strict=True):
            columns |= zip(names, _columns(units, rows[: self._count]), strict=True)
        return Recording(self.time[: self._count].copy(), columns)

    def _grow(self) -> None:
        """Double the capacity."""
        self.time = np.concatenate([self.time, np.empty_like(self.time)])
        self._rows = [np.concatenate([rows, np.empty_like(rows)]) for rows in self._rows]
        self.blocks = [(signals, rows) for (signals, _), rows in zip(self.blocks, self._rows, strict=True)]


def _columns(units: Sequence[str], rows: RealArray) -> Iterator[Column]:
    """Columns of signals with these units, from their rows (N, orders + 1, n)."""
    return map(Column, units, *rows.transpose(1, 2, 0).copy())
