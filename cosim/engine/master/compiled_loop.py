"""The loop over communication points in C: a compiled program is carried out in pieces.

Between the pieces Python reports progress, and the user can interrupt.
"""

from __future__ import annotations

from ctypes import addressof
from functools import cached_property
from typing import Any

import numpy as np

from flexfmu.cosim.engine.fmu.calls import address
from flexfmu.cosim.engine.master.c_library import RunProgram
from flexfmu.cosim.engine.master.grid import TimeGrid
from flexfmu.cosim.engine.master.instructions import CChannel, CProgram, CProgress, Instruction, flags, pack
from flexfmu.cosim.engine.master.program import instructions
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import Schedule


class CompiledLoop:
    """Goes through the points of a grid, in one run after the other.

    Args:
        library: the C side.
        schedule: the order of calls.
        recorder: gets every instant; has room for all of them.
        grid: the points.
    """

    def __init__(self, library: RunProgram, schedule: Schedule, recorder: Recorder, grid: TimeGrid) -> None:
        self._library, self._schedule, self._recorder = library, schedule, recorder
        self._times, self._jumps = np.ascontiguousarray(grid.times), flags(grid.marked)
        self._progress = CProgress()

    def begin(self) -> None:
        """Begin a run; slaves have been initialised, and the first instant is recorded."""
        self._progress = CProgress(points=0, records=self._recorder.count)

    @cached_property
    def _instructions(self) -> tuple[list[Instruction], list[Instruction]]:
        """What happens over a step, and at its end; of slaves that have been initialised once."""
        plan = self._schedule.plan
        return instructions(self._schedule, plan.step), instructions(self._schedule, plan.exchange)

    @cached_property
    def _packed(self) -> list[Any]:
        return [pack(each) for each in self._instructions]

    @cached_property
    def _channels(self) -> Any:
        blocks = self._recorder.blocks
        channels = (CChannel * max(len(blocks), 1))()
        for channel, (signals, rows) in zip(channels, blocks, strict=False):
            channel.signals, channel.rows, channel.count = address(signals), address(rows), signals.size
        return channels

    @cached_property
    def _program(self) -> CProgram:
        # addresses of arrays that live as long as this loop
        (advance, exchange), (n_advance, n_exchange) = self._packed, map(len, self._instructions)
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
            active=addressof(self._schedule.active),
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
        """The error of the instruction that failed."""
        advance, exchange = self._instructions
        index = int(self._progress.instruction)
        stepping = index < len(advance)
        instruction = advance[index] if stepping else exchange[index - len(advance)]
        begin, end = self._times[self.points], self._times[self.points + 1] if stepping else self._times[self.points]
        status = int(self._progress.status)
        return instruction.failure(status, float(begin), float(end))
