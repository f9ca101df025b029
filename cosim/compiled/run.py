"""Carrying a compiled program out: in pieces, so that progress can be told and the user can interrupt."""

from __future__ import annotations

from ctypes import addressof

import numpy as np

from flexfmu.cosim.compiled.library import RunProgram
from flexfmu.cosim.compiled.operations import CChannel, CProgram, CProgress, flags, pack
from flexfmu.cosim.compiled.program import advance_operations, exchange_operations
from flexfmu.cosim.fmu.calls import address
from flexfmu.cosim.master.recorder import Recorder
from flexfmu.cosim.master.schedule import Schedule
from flexfmu.cosim.slave import RealArray


class CompiledRun:
    """Goes through the points of a grid; slaves have been initialised, and the first instant is recorded.

    Args:
        library: the C side.
        schedule: whose turn it is.
        recorder: gets every instant; has room for all of them.
        times: (N + 1,) communication points [s].
        jumps: (N + 1,) where signals may jump.
    """

    def __init__(
        self, library: RunProgram, schedule: Schedule, recorder: Recorder, times: RealArray, jumps: list[bool]
    ) -> None:
        self._library, self._activity, self._recorder = library, schedule.activity, recorder
        self._operations = [advance_operations(schedule), exchange_operations(schedule)]
        self._times = np.ascontiguousarray(times)
        self._jumps = flags(jumps)
        self._packed = [pack(each) for each in self._operations]
        self._channels = (CChannel * max(len(recorder.blocks), 1))()
        for channel, (signals, rows) in zip(self._channels, recorder.blocks, strict=False):
            channel.signals, channel.rows, channel.count = address(signals), address(rows), signals.size
        self._program = self._c_program()
        self._progress = CProgress(points=0, records=recorder.count)

    def _c_program(self) -> CProgram:
        (advance, exchange), (n_advance, n_exchange) = self._packed, map(len, self._operations)
        return CProgram(
            advance=addressof(advance),
            exchange=addressof(exchange),
            n_advance=n_advance,
            n_exchange=n_exchange,
            channels=addressof(self._channels),
            n_channels=len(self._recorder.blocks),
            times=address(self._times),
            jumps=address(self._jumps),
            recorded_times=address(self._recorder.time),
        )

    @property
    def points(self) -> int:
        """Steps that all slaves have completed."""
        return int(self._progress.points)

    def go(self, points: int) -> None:
        """Go on until so many steps are completed.

        Raises:
            BaseException: what the failing slave says, or what was raised in Python.
        """
        failed = self._library(self._program, points, self._progress)
        self._recorder.advance(int(self._progress.records))
        if failed:
            raise self._failure()

    def _failure(self) -> BaseException:
        """The error of the operation that failed."""
        advance, exchange = self._operations
        index = int(self._progress.operation)
        stepping = index < len(advance)
        operation = advance[index] if stepping else exchange[index - len(advance)]
        self._activity.name = operation.owner
        begin, end = self._times[self.points], self._times[self.points + 1] if stepping else self._times[self.points]
        status = int(self._progress.status)
        return operation.failure(status, float(begin), float(end))
