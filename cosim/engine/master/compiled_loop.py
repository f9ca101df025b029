"""The loop over communication points in C: the instructions of a run, executed in pieces.

Between two pieces Python reports progress, and the user can interrupt the run.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import addressof
from functools import cached_property
from typing import Any
from weakref import ref

import numpy as np

from flexfmu.cosim.engine.fmu.calls import address
from flexfmu.cosim.engine.master.c_library import RunProgram
from flexfmu.cosim.engine.master.grid import TimeGrid
from flexfmu.cosim.engine.master.instructions import CChannel, CProgram, CProgress, Instruction, flags, pack
from flexfmu.cosim.engine.master.program import instructions
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import Schedule
from flexfmu.cosim.engine.slave import RealArray


class CompiledLoop:
    """Runs a schedule in C, block by block of its communication points; one loop serves several runs, one after the other.

    Args:
        library: the C function that runs programs.
        schedule: ports and order of calls.
        recorder: records every instant; its capacity must suffice for all of them.
    """

    def __init__(self, library: RunProgram, schedule: Schedule, recorder: Recorder) -> None:
        self._library, self._schedule, self._recorder = library, schedule, recorder
        self._progress, self._program = CProgress(), CProgram()
        # what the program refers to: points and flags of the block, recorded times, tables
        self._grid: TimeGrid | None = None
        self._recorded: Callable[[], RealArray | None] = lambda: None
        self._kept: tuple[object, ...] = ()
        self._tables: dict[int, RealArray] = {}

    def enter(self, grid: TimeGrid) -> None:
        """Go on to these points, after the exchange at the first of them has been executed and recorded."""
        self._progress = CProgress(points=0, records=self._recorder.count)
        # runs one after the other have the same points, often the same memory, and the same tables
        if self._recorder.time is not self._recorded():
            self._program, self._recorded, self._grid = self._prepared(), ref(self._recorder.time), None
        if grid is not self._grid:
            self._take(grid)
        for key, (packed, each) in enumerate(self._reading):
            assert each.table is not None
            if (table := each.table()) is not self._tables.get(key):
                self._tables[key] = table
                packed.source = address(table) + each.offset

    def _take(self, grid: TimeGrid) -> None:
        """Make the program refer to these points."""
        times, jumps, instants = np.ascontiguousarray(grid.times), flags(grid.marked), flags(grid.instants)
        self._program.times, self._program.jumps = address(times), address(jumps)
        self._program.instants = address(instants)
        self._grid, self._times, self._kept = grid, times, (jumps, instants)

    @cached_property
    def _reading(self) -> list[tuple[Any, Instruction]]:
        """The instructions that read from a table, packed and not."""
        pairs = zip(self._packed, self._instructions, strict=True)
        return [both for each in pairs for both in zip(*each, strict=False) if both[1].table is not None]

    @cached_property
    def _instructions(self) -> tuple[list[Instruction], list[Instruction]]:
        """Instructions of a step and of the exchange at its end; the slaves must have been initialised once."""
        plan = self._schedule.plan
        return instructions(self._schedule, plan.step), instructions(self._schedule, plan.exchange)

    @cached_property
    def _packed(self) -> list[Any]:
        return [pack(each) for each in self._instructions]

    def _prepared(self) -> CProgram:
        """The program; the recorder has new memory for each run."""
        blocks = self._recorder.blocks
        self._channels = (CChannel * max(len(blocks), 1))()
        for channel, (signals, columns) in zip(self._channels, blocks, strict=False):
            channel.signals, channel.columns, channel.count = address(signals), address(columns), signals.size
        # the addressed arrays are attributes, so that they live as long as this loop
        (advance, exchange), (n_advance, n_exchange) = self._packed, map(len, self._instructions)
        return CProgram(
            advance=addressof(advance),
            exchange=addressof(exchange),
            n_advance=n_advance,
            n_exchange=n_exchange,
            channels=addressof(self._channels),
            n_channels=len(blocks),
            capacity=self._recorder.time.size,
            recorded_times=address(self._recorder.time),
            active=addressof(self._schedule.active),
        )

    @property
    def points(self) -> int:
        """Number of steps of the current block that all slaves have completed."""
        return int(self._progress.points)

    def go(self, points: int) -> None:
        """Continue until ``points`` steps of the current block are completed.

        Raises:
            BaseException: the error of the slave that failed, or the exception of a Python callback.
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
