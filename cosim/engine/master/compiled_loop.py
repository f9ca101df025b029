"""The loop over communication points in C: the operations of a plan, translated into instructions (``master.h``), executed in pieces.

Between two pieces Python reports progress, and the user can interrupt the run. An operation that isn't an FMI call, a copy, a row of a
table or the evaluation of a block becomes a callback to the Python call of `Schedule.bind`, so that the results are those of the loop in
Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from ctypes import CFUNCTYPE, addressof, c_double, c_int, c_size_t, c_void_p, cast
from enum import IntEnum
from functools import cache, cached_property, partial
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine import binding
from flexfmu.cosim.engine.fmu.calls import address
from flexfmu.cosim.engine.fmu.instance import Checked
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.grid import TimeGrid
from flexfmu.cosim.engine.master.ports import OutputPort, SignalGroup
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import Action, Operation, Schedule, When
from flexfmu.cosim.engine.shared_library import c_structures, shared_library
from flexfmu.cosim.engine.slave import Call, Indices, RealArray
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.fmu_build.errors import BuildError

CALLBACK = CFUNCTYPE(c_int, c_size_t, c_double, c_double)
"""A Python function that C calls with the index of the point, begin and end [s]; it returns 0, else the run stops."""

Failure = Callable[[int, float, float], BaseException]
"""(status, begin [s], end [s]) of a failed instruction → the exception to raise."""


class Opcode(IntEnum):
    """Kind of an instruction; the numbers of ``master.h``."""

    VALUES = 0
    DERIVATIVES = 1
    STEP = 2
    COPY = 3
    GATHER = 4
    FINITE = 5
    EVALUATE = 6
    SAMPLE = 7
    TASK = 8
    REFRESH = 9
    MULTIPLY = 10
    ADD = 11
    CALL = 12


CInstruction, CChannel, CProgram, CProgress = (
    c_structures("master")[f"master_{name}"] for name in ("instruction", "channel", "program", "progress")
)


class Instruction:
    """One instruction of the loop in C.

    Args:
        kind: what it does.
        when: at which points it is executed.
        owner: index of the slave that is called.
        failure: creates the exception if it fails; None if it can't.
        kept: further objects that pointers refer to, to keep them alive.
        fields: fields of ``master_instruction``; an array stands for its address, and is kept alive.

    Attributes:
        table: returns the table of the current block, which the source is in; None without a table.
        offset: distance of the source from the beginning of the table [bytes].
    """

    def __init__(
        self, kind: Opcode, when: When, owner: int, failure: Failure | None = None, kept: object = None, **fields: Any
    ) -> None:
        self.kind, self.when, self.owner, self.fields, self._kept = kind, when, owner, fields, kept
        self.failure = failure or (lambda status, begin, end: AssertionError(f"status {status} of {kind.name}"))
        self.table: Callable[[], RealArray] | None = None
        self.offset = 0

    def read_from(self, table: Callable[[], RealArray]) -> None:
        """Read from a table that is another array in each block; now it is that of the source."""
        self.table, self.offset = table, address(self.fields["source"]) - address(table())

    def due(self, flags: NDArray[np.uint8]) -> None:
        """Execute the instruction only at the points whose flag is set."""
        self.when, self.fields["due"] = When.WHEN_DUE, flags


def fmi_transfer(call: partial[int], when: When, owner: int, failure: Failure, **fields: Any) -> Instruction:
    """fmi2GetReal, fmi2SetReal, or the functions for their derivatives, with bound arguments."""
    _, references, count, *orders, target = call.args
    fields = {"references": references, "count": count, "target": target, **_reached(call), **fields}
    if orders:
        return Instruction(Opcode.DERIVATIVES, when, owner, failure, call, orders=orders[0], **fields)
    # a source is copied into the target first, where it differs
    kind = Opcode.REFRESH if "source" in fields else Opcode.VALUES
    return Instruction(kind, when, owner, failure, call, **fields)


def _reached(call: partial[int]) -> dict[str, int | None]:
    """Pointers to an FMI function and to the handle of its instance."""
    return {"function": pointer(call.func), "component": addressof(call.args[0])}


def evaluation(
    call: binding.Evaluation, when: When, owner: int, again: binding.Reevaluation | None = None
) -> Instruction:
    """Evaluates the equations of a block; with ``again`` only if its inputs have changed."""
    fields: dict[str, Any] = {"function": call.function, "component": addressof(call.argument)}
    if again is not None:
        fields |= {"count": again.inputs.size, "source": again.inputs, "target": again.seen}
    return Instruction(Opcode.EVALUATE, when, owner, kept=call, **fields)


def gather(
    source: RealArray, columns: Indices, target: RealArray, places: Indices, when: When, owner: int, stride: int = 0
) -> Instruction:
    """``target.flat[places] = source.flat[columns]``; one copy if both are consecutive.

    With a stride ``source`` is a table, and the columns count from the beginning of its row ``point``.
    """
    fields: dict[str, Any] = {"count": columns.size, "stride": stride}
    if binding.is_range(columns) and binding.is_range(places):
        source, target = source.reshape(-1)[columns[0] :], target.reshape(-1)[places[0] : places[-1] + 1]
        return Instruction(Opcode.COPY, when, owner, source=source, target=target, **fields)
    columns, places = (np.ascontiguousarray(each, dtype=np.int64) for each in (columns, places))
    fields |= {"source": source, "columns": columns, "target": target, "places": places}
    return Instruction(Opcode.GATHER, when, owner, **fields)


def python_callback(function: Callable[[int, float, float], object], when: When, owner: int) -> Instruction:
    """Calls a Python function; an exception that it raises ends the run."""
    raised: list[BaseException] = []

    def guarded(point: int, begin: float, end: float) -> int:
        try:
            function(point, begin, end)
        except BaseException as error:  # raised again after C has returned
            raised.append(error)
            return 1
        return 0

    def failure(status: int, begin: float, end: float) -> BaseException:
        # only a signal raises outside the `try`, and ctypes drops what is raised there
        return raised.pop() if raised else KeyboardInterrupt()

    callback = CALLBACK(guarded)
    return Instruction(Opcode.CALL, when, owner, failure, callback, function=pointer(callback))


def pointer(function: Any) -> int | None:
    """Address of a C function."""
    address_of: int | None = cast(function, c_void_p).value
    return address_of


RunProgram = Callable[[Any, int, Any], int]
"""Runs a ``master_program`` until so many steps are completed; returns 0, or 1 if an instruction failed."""


@cache
def load() -> RunProgram | None:
    """The C function that runs programs; None if it can't be compiled or loaded, for example without a C compiler."""
    try:
        function: Any = shared_library("master").master_run
    except BuildError:
        return None
    return lambda program, points, progress: int(function(program, points, progress))


PHASES: Mapping[Action, binding.Phase] = {Action.SAMPLE: "sample", Action.OUTPUT: "output", Action.UPDATE: "update"}
"""What a slave calculates in an operation at a sample instant."""


def translation(schedule: Schedule, operation: Operation) -> Iterator[Instruction]:
    """The instructions of one operation: in C where there is an equivalent, else a Python callback.

    In place of a trajectory's announcements and steps they read tables with a row per communication point.
    """
    i, when = operation.slave, operation.when
    slave, inputs, outputs = schedule.slaves[i], schedule.inputs[i], schedule.outputs[i]
    rows, table = len(outputs.signals), slave if isinstance(slave, TrajectorySlave) else None
    match operation.action:
        # outputs from a row of a table
        case Action.ANNOUNCE if table is not None and table.announced.shape[1] >= rows:
            yield table_row(lambda: table.announced, outputs, i, rows)
        case Action.STEP if table is not None:
            yield table_row(lambda: table.ended, outputs, i, outputs.recorded)
        case Action.READ if table is not None:
            return
        # calls of an FMU, and copies between buffers
        case Action.READ:
            if outputs.indices.size:
                yield from transfer_of(outputs.transfer, when, i)
                signals, failure = outputs.signals, lambda status, begin, end: outputs.not_finite(end)
                yield Instruction(Opcode.FINITE, when, i, failure, count=signals.size, target=signals)
        case Action.FEED:
            for group in inputs.groups:
                yield from extrapolation(group, inputs.fed, when, i)
            yield from transfer_of(inputs.send, when, i)
        case Action.STEP if isinstance(slave, FmuSlave) and (bound := slave.bound_step()) is not None:
            # noSetFMUStatePriorToCurrentPoint = true: the slave is never rolled back
            step, error = bound
            failed = lambda status, begin, end: error(status, begin, end - begin)  # noqa: E731
            yield Instruction(Opcode.STEP, When.ALWAYS, i, failed, step, **_reached(step))
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
    calls = slave.sample_calls(PHASES[operation.action]) if isinstance(slave, binding.SamplesInC) else None
    if calls is None:
        yield python_callback(schedule.bind(operation), when, i)
        return
    for call in calls:
        match call:
            case binding.SampleStep():
                kind, step = Opcode.TASK if call.is_task else Opcode.SAMPLE, call.step
                yield Instruction(kind, when, i, call.failure, call, target=call.state, **_reached(step))
            case binding.Reevaluation():
                yield evaluation(call.evaluation, when, i, call)
            case _:
                yield from transfer_of(call, when, i)


def table_row(table: Callable[[], RealArray], outputs: OutputPort, owner: int, rows: int) -> Instruction:
    """Copies row ``point`` of the current table (points, orders, variables) into the port: its first ``rows`` orders."""
    _, orders, count = table().shape
    columns = np.arange(rows)[:, None] * count + outputs.indices
    places = np.arange(rows * outputs.indices.size)
    row = gather(table(), columns.ravel(), outputs.signals, places, When.ALWAYS, owner, orders * count)
    row.read_from(table)
    return row


def extrapolation(group: SignalGroup, fed: RealArray, when: When, owner: int) -> Iterator[Instruction]:
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
        factor, offset, places = (
            np.tile(mapping.factor, count),
            np.ascontiguousarray(mapping.offset),
            places.astype(np.int64),
        )
        for kind, source, where in ((Opcode.MULTIPLY, factor, places.ravel()), (Opcode.ADD, offset, places[0])):
            yield Instruction(kind, when, owner, count=where.size, source=source, target=fed, places=where)


def transfer_of(call: Call, when: When, owner: int) -> Iterator[Instruction]:
    """The instructions of a bound transfer: in C where there is an equivalent, else a Python callback."""
    match call:
        case binding.nothing:
            return
        # values first, then derivatives
        case binding.Both():
            yield from transfer_of(call.first, when, owner)
            yield from transfer_of(call.second, when, owner)
        # an FMI function on fixed buffers
        case Checked() if isinstance(call.call, partial):
            yield fmi_transfer(call.call, when, owner, lambda status, begin, end: call.error(status))
        # equations, and copies between buffers
        case binding.Evaluation():
            yield evaluation(call, when, owner)
        case binding.Copy() if call.source.flags.c_contiguous and call.target.flags.c_contiguous:
            yield gather(call.source, np.arange(call.source.size), call.target, call.indices, when, owner)
        case binding.Take() if call.target.flags.c_contiguous:
            yield gather(call.source, call.indices, call.target, np.arange(call.target.size), when, owner)
        case binding.Refresh() if isinstance(call.send, Checked) and isinstance(call.send.call, partial):
            error, fields = call.send.error, {"source": call.take.source, "columns": call.take.indices.astype(np.int64)}
            yield fmi_transfer(call.send.call, when, owner, lambda status, begin, end: error(status), **fields)
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
            times, jumps = np.ascontiguousarray(grid.times), grid.marked.astype(np.uint8)
            instants = grid.instants.astype(np.uint8)
            self._program.times, self._program.jumps = address(times), address(jumps)
            self._program.instants = address(instants)
            self._grid, self._times, self._kept = grid, times, (jumps, instants)
        for key, (packed, each) in enumerate(self._reading):
            assert each.table is not None
            if (table := each.table()) is not self._tables.get(key):
                self._tables[key] = table
                packed.source = address(table) + each.offset

    @cached_property
    def _reading(self) -> list[tuple[Any, Instruction]]:
        """The instructions that read from a table, packed and not."""
        pairs = zip(self._packed, self._instructions, strict=True)
        return [both for each in pairs for both in zip(*each, strict=False) if both[1].table is not None]

    @cached_property
    def _instructions(self) -> tuple[list[Instruction], list[Instruction]]:
        """Instructions of a step and of the exchange at its end; the slaves must have been initialised once."""
        plan = self._schedule.plan
        step, exchange = (
            [found for each in operations for found in translation(self._schedule, each)]
            for operations in (plan.step, plan.exchange)
        )
        return step, exchange

    @cached_property
    def _packed(self) -> list[Any]:
        """The same as C arrays."""
        arrays = [(CInstruction * max(len(each), 1))() for each in self._instructions]
        for array, instructions in zip(arrays, self._instructions, strict=True):
            for packed, each in zip(array, instructions, strict=False):
                packed.kind, packed.condition, packed.owner = each.kind, each.when, each.owner
                for name, value in each.fields.items():
                    setattr(packed, name, address(value) if isinstance(value, np.ndarray) else value)
        return arrays

    def _prepared(self) -> Any:
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
