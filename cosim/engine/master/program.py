"""Translates the operations of a plan into instructions for the loop in C.

An operation that isn't an FMI call, a copy or a row of a table becomes a callback to the Python call of
`Schedule.bind`, so that the results are those of the loop in Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np

from flexfmu.cosim.engine.binding import Both, Copy, is_range
from flexfmu.cosim.engine.fmu.instance import Checked
from flexfmu.cosim.engine.master.instructions import (
    Instruction,
    copy,
    finite,
    flags,
    fmi_step,
    fmi_transfer,
    gather,
    python_callback,
    table_row,
)
from flexfmu.cosim.engine.master.plan import Action, Operation, When
from flexfmu.cosim.engine.master.ports import SignalGroup
from flexfmu.cosim.engine.master.schedule import Schedule
from flexfmu.cosim.engine.slave import Call, RealArray


@runtime_checkable
class HasTables(Protocol):
    """Predicts all of its outputs: in C, tables with a row per communication point replace `announce` and `step`.

    The tables don't change afterwards; runs with the same points have the same tables.

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


def can_compile(schedule: Schedule) -> bool:
    """Whether the plan can run in C: it has no loops to iterate."""
    return not schedule.plan.has_loops


def instructions(schedule: Schedule, operations: Iterable[Operation]) -> list[Instruction]:
    """The instructions for these operations, in the same order."""
    tables = {
        i: slave
        for i, slave in schedule.predicting.items()
        if isinstance(slave, HasTables) and schedule.outputs[i].reads_all
    }
    return [found for each in operations for found in _translation(schedule, tables, each)]


def _translation(schedule: Schedule, tables: Mapping[int, HasTables], operation: Operation) -> Iterator[Instruction]:
    """The instructions of one operation: in C where there is an equivalent, else a Python callback."""
    i, when = operation.slave, operation.when
    slave, inputs, outputs = schedule.slaves[i], schedule.inputs[i], schedule.outputs[i]
    rows, table = len(outputs.signals), tables.get(i)
    match operation.action:
        # outputs from a row of a table
        case Action.ANNOUNCE if table is not None and table.announced.shape[1] >= rows:
            yield table_row(table.announced, outputs.signals, i, rows)
        case Action.STEP if table is not None:
            yield table_row(table.ended, outputs.signals, i, outputs.recorded)
        case Action.READ if table is not None:
            return
        # calls of an FMU, and copies between buffers
        case Action.READ:
            if outputs.indices.size:
                yield from _transfer(outputs.transfer, when, i)
                yield finite(outputs.signals, when, i, lambda status, begin, end: outputs.not_finite(end))
        case Action.FEED:
            for group in inputs.groups:
                yield _extrapolation(group, inputs.fed, when, i)
            yield from _transfer(inputs.send, when, i)
        case Action.STEP if isinstance(slave, StepsInC) and (bound := slave.bound_step()) is not None:
            step, failure = bound
            yield fmi_step(step, i, lambda status, begin, end: failure(status, begin, end - begin))
        # all other operations
        case _:
            callback = python_callback(schedule.bind(operation), when, i)
            if when is When.WHEN_DUE:
                callback.due(flags(schedule.due[i]))
            yield callback


def _extrapolation(group: SignalGroup, fed: RealArray, when: When, owner: int) -> Instruction:
    """The instruction equivalent to `SignalGroup.extrapolation`; a Python callback if the signals are mapped."""
    if group.transformation is not None:
        extrapolate = group.extrapolation(fed)
        return python_callback(lambda point, begin, end: extrapolate(), when, owner)
    # flat indices of the signals in both buffers, row by row; further rows stay zero
    rows = np.arange(group.coupling.order + 1)[:, None]
    columns = rows * group.source.signals.shape[1] + group.columns
    places = rows * fed.shape[1] + np.arange(fed.shape[1])[group.slots]
    columns, places = (np.ascontiguousarray(each.ravel(), dtype=np.int64) for each in (columns, places))
    # one copy if both are contiguous
    source, target = group.source.signals.reshape(-1), fed.reshape(-1)
    if is_range(columns) and is_range(places):
        return copy(source[columns[0] : columns[-1] + 1], target[places[0] : places[-1] + 1], when, owner)
    return gather(source, columns, target, places, when, owner)


def _transfer(call: Call, when: When, owner: int) -> Iterator[Instruction]:
    """The instructions of a bound transfer: in C where there is an equivalent, else a Python callback."""
    # values first, then derivatives
    if isinstance(call, Both):
        yield from _transfer(call.first, when, owner)
        yield from _transfer(call.second, when, owner)
    # an FMI function on fixed buffers
    elif isinstance(call, Checked) and isinstance(call.call, partial):
        checked = call
        yield fmi_transfer(call.call, when, owner, lambda status, begin, end: checked.error(status))
    elif isinstance(call, Copy) and call.is_contiguous:
        yield copy(call.source, call.target[call.place], when, owner)
    else:
        yield python_callback(lambda point, begin, end: call(), when, owner)
