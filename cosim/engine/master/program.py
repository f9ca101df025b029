"""A schedule as a list of operations for the C side: the same calls in the same order as `Schedule` and `Stepping`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np

from flexfmu.cosim.engine.binding import Both, Copy, is_range
from flexfmu.cosim.engine.fmu.instance import Checked
from flexfmu.cosim.engine.master.exchange import ExchangeStep, InstantLoop
from flexfmu.cosim.engine.master.operations import (
    Operation,
    When,
    copy,
    finite,
    flags,
    fmi_step,
    fmi_transfer,
    gather,
    python_callback,
    table_row,
)
from flexfmu.cosim.engine.master.ports import InputPort, OutputPort, SignalGroup
from flexfmu.cosim.engine.master.schedule import Schedule
from flexfmu.cosim.engine.master.stepping import Stepper
from flexfmu.cosim.engine.slave import Call, PredictsOutputs, RealArray


@runtime_checkable
class HasTables(Protocol):
    """Predicts all of its outputs: what `announce` and `step` change over to is in tables, a row for each point.

    Tables are never written to again; for the same points each run finds the same.

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
    """Is stepped by fmi2DoStep."""

    def bound_step(self) -> tuple[partial[int], Callable[[int, float, float], BaseException]] | None:
        """The function with its component bound, and what makes the error; None where `step` has more to do."""


def can_compile(schedule: Schedule) -> bool:
    """Whether the schedule is the same at every point: nothing is repeated until it agrees."""
    loops = any(isinstance(step, InstantLoop) for step in schedule.exchange_steps)
    return not loops and not schedule.stepping.iterates


def advance_operations(schedule: Schedule) -> list[Operation]:
    """Over a step: what `Stepping.advance` does."""
    operations = [
        _call(each.inputs.remember, When.ALWAYS, each.index) for each in schedule.stepping.single if each.interpolating
    ]
    for stepper in schedule.stepping.single:
        slave, port = stepper.slave, stepper.outputs
        if stepper.interpolating:
            operations.append(python_callback(_interpolation(stepper.inputs), When.ALWAYS, stepper.index))
        if isinstance(slave, HasTables) and port.reads_all:
            operations.append(table_row(slave.ended, port.signals, stepper.index, port.recorded))
            continue
        operations += [_step(stepper), *_read(port, When.ALWAYS, stepper.index)]
    return operations


def exchange_operations(schedule: Schedule) -> list[Operation]:
    """At a communication point: what `Schedule.exchange` does."""
    operations: list[Operation] = []
    for index, slave, port in schedule.predicting:
        operations += _announcement(index, slave, port)
    operations += _exchange_pass(schedule, When.ALWAYS)
    for _ in range(schedule.rounds):
        operations += _exchange_pass(schedule, When.AT_JUMPS)
    for step in schedule.updating:
        if step.update is not None:
            operations.append(_sampling(step, step.update))
    return operations


def _exchange_pass(schedule: Schedule, when: When) -> Iterator[Operation]:
    """What `Schedule._pass_on` does: inputs, samples (not in further rounds), outputs, slave by slave."""
    for step in schedule.exchange_steps:
        if not isinstance(step, ExchangeStep):
            continue
        yield from _feed(step.inputs, when, step.index)
        if step.sample is not None and when is When.ALWAYS:
            yield _sampling(step, step.sample)
        yield from _read(step.outputs, when if step.stale else When.AT_JUMPS, step.index)


def _announcement(index: int, slave: PredictsOutputs, port: OutputPort) -> list[Operation]:
    """Change over to the polynomial of the coming step."""
    rows = len(port.signals)
    if isinstance(slave, HasTables) and port.reads_all and slave.announced.shape[1] >= rows:
        return [table_row(slave.announced, port.signals, index, rows)]

    def announce(point: int, begin: float, end: float) -> None:
        slave.announce(begin)
        port.read_announced()

    return [python_callback(announce, When.ALWAYS, index)]


def _feed(port: InputPort, when: When, owner: int) -> Iterator[Operation]:
    """Set a slave's inputs from the outputs that feed them."""
    for group in port.groups:
        if group.transformation is None:
            yield _gather(group, port.fed, when, owner)
        else:
            yield python_callback(_extrapolation(group, port.fed), when, owner)
    yield from _transfer(port.send, when, owner)


def _gather(group: SignalGroup, fed: RealArray, when: When, owner: int) -> Operation:
    """What `SignalGroup.extrapolation` does; rows beyond stay zero."""
    rows = np.arange(group.coupling.order + 1)[:, None]
    columns = rows * group.source.signals.shape[1] + group.columns
    places = rows * fed.shape[1] + np.arange(fed.shape[1])[group.slots]
    columns, places = (np.ascontiguousarray(each.ravel(), dtype=np.int64) for each in (columns, places))
    source, target = group.source.signals.reshape(-1), fed.reshape(-1)
    if is_range(columns) and is_range(places):
        return copy(source[columns[0] : columns[-1] + 1], target[places[0] : places[-1] + 1], when, owner)
    return gather(source, columns, target, places, when, owner)


def _read(port: OutputPort, when: When, owner: int) -> Iterator[Operation]:
    """Read a slave's outputs and look at them."""
    if not port.indices.size:
        return
    yield from _transfer(port.transfer, when, owner)
    yield finite(port.signals, when, owner, lambda status, begin, end: port.not_finite(end))


def _transfer(call: Call, when: When, owner: int) -> Iterator[Operation]:
    """A bound call, in C where it is known what it does."""
    if isinstance(call, Both):
        yield from _transfer(call.first, when, owner)
        yield from _transfer(call.second, when, owner)
    elif isinstance(call, Checked) and isinstance(call.call, partial):
        checked = call
        yield fmi_transfer(call.call, when, owner, lambda status, begin, end: checked.error(status))
    elif isinstance(call, Copy) and call.is_contiguous:
        yield copy(call.source, call.target[call.place], when, owner)
    else:
        yield _call(call, when, owner)


def _step(stepper: Stepper) -> Operation:
    """Advance one slave."""
    slave = stepper.slave
    if isinstance(slave, StepsInC) and (bound := slave.bound_step()) is not None:
        call, failure = bound
        return fmi_step(call, stepper.index, lambda status, begin, end: failure(status, begin, end - begin))
    return python_callback(lambda point, begin, end: slave.step(begin, end - begin), When.ALWAYS, stepper.index)


def _sampling(step: ExchangeStep, sample: Callable[[float], None]) -> Operation:
    """Let a slave sample where it is due."""
    operation = python_callback(lambda point, begin, end: sample(end), When.ALWAYS, step.index)
    operation.due(flags(step.due))
    return operation


def _call(call: Call, when: When, owner: int) -> Operation:
    return python_callback(lambda point, begin, end: call(), when, owner)


def _extrapolation(group: SignalGroup, fed: RealArray) -> Callable[[int, float, float], None]:
    extrapolate = group.extrapolation(fed)

    def call(point: int, begin: float, end: float) -> None:
        extrapolate()

    return call


def _interpolation(inputs: InputPort) -> Callable[[int, float, float], None]:
    return lambda point, begin, end: inputs.interpolate(end - begin)
