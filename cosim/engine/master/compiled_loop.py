"""The loop over communication points in C: the operations of a plan, translated into instructions, executed in pieces.

Between two pieces Python reports progress, and the user can interrupt the run. An operation that isn't an FMI call, a copy, a row of a
table or the evaluation of a block becomes a callback to the Python call of `Schedule.bind`, so that the results are those of the loop in
Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from ctypes import addressof
from functools import cached_property, partial
from typing import Any, Protocol, runtime_checkable
from weakref import ref

import numpy as np

from flexfmu.cosim.engine.binding import (
    Both,
    Copy,
    Evaluation,
    Phase,
    Reevaluation,
    Refresh,
    SamplesInC,
    SampleStep,
    Take,
)
from flexfmu.cosim.engine.fmu.calls import address
from flexfmu.cosim.engine.fmu.instance import Checked
from flexfmu.cosim.engine.master.c_library import RunProgram
from flexfmu.cosim.engine.master.grid import TimeGrid
from flexfmu.cosim.engine.master.instructions import (
    CChannel,
    CProgram,
    CProgress,
    Instruction,
    Opcode,
    combine,
    evaluation,
    finite,
    flags,
    fmi_step,
    fmi_transfer,
    gather,
    pack,
    python_callback,
    refresh,
    sample_step,
)
from flexfmu.cosim.engine.master.plan import Action, Operation, When
from flexfmu.cosim.engine.master.ports import OutputPort, SignalGroup
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import Schedule
from flexfmu.cosim.engine.slave import Call, RealArray


@runtime_checkable
class HasTables(Protocol):
    """Predicts all of its outputs: in C, tables with a row per communication point replace `announce` and `step`.

    There are new tables after each `prepare`, with the same number of orders.

    Attributes:
        announced: (N, orders, n) value and derivatives after `announce` at each communication point.
        ended: (N, orders, n) value and derivatives after the `step` that ends at each communication point.
    """

    @property
    def announced(self) -> RealArray: ...
    @property
    def ended(self) -> RealArray: ...


@runtime_checkable
class StepsInC(Protocol):
    """Can be stepped by calling fmi2DoStep directly."""

    def bound_step(self) -> tuple[partial[int], Callable[[int, float, float], BaseException]] | None:
        """fmi2DoStep with its component bound, and the function that creates the error; None if `step` does more."""


PHASES: Mapping[Action, Phase] = {Action.SAMPLE: "sample", Action.OUTPUT: "output", Action.UPDATE: "update"}
"""What a slave calculates in an operation at a sample instant."""


def can_compile(schedule: Schedule) -> bool:
    """Whether the plan can run in C: it has no loops to iterate."""
    return not schedule.plan.has_loops


def instructions(schedule: Schedule, operations: Iterable[Operation]) -> list[Instruction]:
    """The instructions for these operations, in the same order."""
    tables = {i: slave for i, slave in schedule.predicting.items() if isinstance(slave, HasTables)}
    return [found for each in operations for found in _translation(schedule, tables, each)]


def _translation(schedule: Schedule, tables: Mapping[int, HasTables], operation: Operation) -> Iterator[Instruction]:
    """The instructions of one operation: in C where there is an equivalent, else a Python callback."""
    i, when = operation.slave, operation.when
    slave, inputs, outputs = schedule.slaves[i], schedule.inputs[i], schedule.outputs[i]
    rows, table = len(outputs.signals), tables.get(i)
    match operation.action:
        # outputs from a row of a table
        case Action.ANNOUNCE if table is not None and table.announced.shape[1] >= rows:
            yield _table_row(lambda: table.announced, outputs, i, rows)
        case Action.STEP if table is not None:
            yield _table_row(lambda: table.ended, outputs, i, outputs.recorded)
        case Action.READ if table is not None:
            return
        # calls of an FMU, and copies between buffers
        case Action.READ:
            if outputs.indices.size:
                yield from _transfer(outputs.transfer, when, i)
                yield finite(outputs.signals, when, i, lambda status, begin, end: outputs.not_finite(end))
        case Action.FEED:
            for group in inputs.groups:
                yield from _extrapolation(group, inputs.fed, when, i)
            yield from _transfer(inputs.send, when, i)
        case Action.STEP if isinstance(slave, StepsInC) and (bound := slave.bound_step()) is not None:
            step, failure = bound
            yield fmi_step(step, i, lambda status, begin, end: failure(status, begin, end - begin))
        # samples
        case Action.SAMPLE | Action.OUTPUT | Action.UPDATE:
            due = np.frombuffer(schedule.due[i], np.uint8)
            for each in _sample(schedule, operation):
                each.due(due)
                yield each
        # all other operations
        case _:
            yield python_callback(schedule.bind(operation), when, i)


def _sample(schedule: Schedule, operation: Operation) -> Iterator[Instruction]:
    """The instructions of a sample, where the slave is due."""
    i, when = operation.slave, operation.when
    slave = schedule.slaves[i]
    calls = slave.sample_calls(PHASES[operation.action]) if isinstance(slave, SamplesInC) else None
    if calls is None:
        yield python_callback(schedule.bind(operation), when, i)
        return
    for call in calls:
        match call:
            case SampleStep():
                yield sample_step(call, when, i)
            case Reevaluation():
                yield evaluation(call.evaluation, when, i, call)
            case _:
                yield from _transfer(call, when, i)


def _table_row(table: Callable[[], RealArray], outputs: OutputPort, owner: int, rows: int) -> Instruction:
    """Copies row ``point`` of the current table (points, orders, variables) into the port: its first ``rows`` orders."""
    _, orders, count = table().shape
    columns = np.arange(rows)[:, None] * count + outputs.indices
    places = np.arange(rows * outputs.indices.size)
    row = gather(table(), columns.ravel(), outputs.signals, places, When.ALWAYS, owner, orders * count)
    row.read_from(table)
    return row


def _extrapolation(group: SignalGroup, fed: RealArray, when: When, owner: int) -> Iterator[Instruction]:
    """The instructions equivalent to `SignalGroup.extrapolation`; a Python callback if signals are mapped by tables, or
    if a map changes the sign of rows that aren't extrapolated, which stay zero here."""
    mapping, count = group.transformation, group.coupling.order + 1
    if mapping is not None and (mapping.tables or (len(fed) > count and (mapping.factor < 0.0).any())):
        extrapolate = group.extrapolation(fed)
        yield python_callback(lambda point, begin, end: extrapolate(), when, owner)
        return
    # flat indices of the signals in both buffers, row by row
    rows = np.arange(count)[:, None]
    columns = rows * group.source.signals.shape[1] + group.columns
    places = rows * fed.shape[1] + np.arange(fed.shape[1])[group.slots]
    yield gather(group.source.signals, columns.ravel(), fed, places.ravel(), when, owner)
    if mapping is not None:
        yield combine(Opcode.MULTIPLY, np.tile(mapping.factor, count), fed, places.ravel(), when, owner)
        yield combine(Opcode.ADD, mapping.offset, fed, places[0], when, owner)


def _transfer(call: Call, when: When, owner: int) -> Iterator[Instruction]:
    """The instructions of a bound transfer: in C where there is an equivalent, else a Python callback."""
    match call:
        # values first, then derivatives
        case Both():
            yield from _transfer(call.first, when, owner)
            yield from _transfer(call.second, when, owner)
        # an FMI function on fixed buffers
        case Checked() if isinstance(call.call, partial):
            yield fmi_transfer(call.call, when, owner, lambda status, begin, end: call.error(status))
        # equations, and copies between buffers
        case Evaluation():
            yield evaluation(call, when, owner)
        case Copy() if call.source.flags.c_contiguous and call.target.flags.c_contiguous:
            yield gather(call.source, np.arange(call.source.size), call.target, call.indices, when, owner)
        case Take() if call.target.flags.c_contiguous:
            yield gather(call.source, call.indices, call.target, np.arange(call.target.size), when, owner)
        case Refresh() if isinstance(call.send, Checked) and isinstance(call.send.call, partial):
            failure = call.send.error
            yield refresh(call, call.send.call, when, owner, lambda status, begin, end: failure(status))
        case _:
            yield python_callback(lambda point, begin, end: call(), when, owner)


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
