"""The instructions of the loop in C, and the structures that the C code reads (``master.h``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from ctypes import CFUNCTYPE, Structure, addressof, c_double, c_int, c_size_t, c_ubyte, c_void_p, cast
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.binding import Evaluation, Reevaluation, Refresh, SampleStep, is_range
from flexfmu.cosim.engine.fmu.calls import address
from flexfmu.cosim.engine.master.plan import When
from flexfmu.cosim.engine.slave import Indices, RealArray

CALLBACK = CFUNCTYPE(c_int, c_size_t, c_double, c_double)
"""A Python function that C calls with the index of the point, begin and end [s]; it returns 0, else the run stops."""

Failure = Callable[[int, float, float], BaseException]
"""(status, begin [s], end [s]) of a failed instruction → the exception to raise."""

_FIELDS = ("function", "component", "references", "orders", "columns", "places", "source", "target", "due")


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


class CInstruction(Structure):
    """``master_instruction``."""

    _fields_ = (
        *((name, c_int) for name in ("kind", "condition", "owner")),
        *((name, c_size_t) for name in ("count", "stride")),
        *((name, c_void_p) for name in _FIELDS),
    )


class CChannel(Structure):
    """``master_channel``."""

    _fields_ = (("signals", c_void_p), ("columns", c_void_p), ("count", c_size_t))


class CProgram(Structure):
    """``master_program``."""

    _fields_ = (
        *((name, c_void_p) for name in ("advance", "exchange")),
        *((name, c_size_t) for name in ("n_advance", "n_exchange")),
        ("channels", c_void_p),
        *((name, c_size_t) for name in ("n_channels", "capacity")),
        *((name, c_void_p) for name in ("times", "jumps", "instants", "recorded_times", "active")),
    )


class CProgress(Structure):
    """``master_progress``."""

    _fields_ = (("points", c_size_t), ("records", c_size_t), ("instruction", c_size_t), ("status", c_int))


@dataclass
class Instruction:
    """One instruction of the loop in C.

    Attributes:
        kind: what it does.
        when: at which points it is executed.
        owner: index of the slave that is called.
        failure: creates the exception if it fails.
        numbers: values of the fields ``count`` and ``stride``, if it uses them.
        addresses: field → pointer.
        kept: the objects that the pointers refer to, to keep them alive.
        table: returns the table of the current block; None without a table.
        offset: distance of the source from the beginning of the table [bytes].
    """

    kind: Opcode
    when: When
    owner: int
    failure: Failure
    numbers: dict[str, int] = field(default_factory=dict)
    addresses: dict[str, int | None] = field(default_factory=dict)
    kept: tuple[Any, ...] = ()
    table: Callable[[], RealArray] | None = None
    offset: int = 0

    def read_from(self, table: Callable[[], RealArray]) -> None:
        """Read from a table that is another array in each block; now it is that of the source."""
        self.table, self.offset = table, (self.addresses["source"] or 0) - address(table())

    def due(self, flags: NDArray[np.uint8]) -> None:
        """Execute the instruction only at the points whose flag is set."""
        self.when = When.WHEN_DUE
        self.addresses["due"] = flags.ctypes.data_as(c_void_p).value
        self.kept = (*self.kept, flags)


def pack(instructions: Sequence[Instruction]) -> Any:
    """The instructions as a C array."""
    packed = (CInstruction * max(len(instructions), 1))()
    for each, one in zip(packed, instructions, strict=False):
        each.kind, each.condition, each.owner = one.kind, one.when, one.owner
        for name, value in {**one.numbers, **one.addresses}.items():
            setattr(each, name, value)
    return packed


def fmi_transfer(call: partial[int], when: When, owner: int, failure: Failure) -> Instruction:
    """fmi2GetReal, fmi2SetReal, or the functions for their derivatives, with bound arguments."""
    _, references, count, *orders, target = call.args
    pointers = {**_reached(call), "references": references, "target": target}
    kind = Opcode.DERIVATIVES if orders else Opcode.VALUES
    more = {"orders": orders[0]} if orders else {}
    return Instruction(kind, when, owner, failure, {"count": count}, {**pointers, **more}, (call,))


def refresh(call: Refresh, send: partial[int], when: When, owner: int, failure: Failure) -> Instruction:
    """fmi2SetReal of the values that are taken, unless they are those sent last."""
    packed, columns = fmi_transfer(send, when, owner, failure), call.take.indices.astype(np.int64)
    packed.kind = Opcode.REFRESH
    packed.addresses |= {"source": address(call.take.source), "columns": address(columns)}
    packed.kept = (*packed.kept, call, columns)
    return packed


def fmi_step(call: partial[int], owner: int, failure: Failure) -> Instruction:
    """fmi2DoStep with noSetFMUStatePriorToCurrentPoint = true: the slave is never rolled back."""
    return Instruction(Opcode.STEP, When.ALWAYS, owner, failure, {}, _reached(call), (call,))


def _reached(call: partial[int]) -> dict[str, int | None]:
    """Pointers to an FMI function and to the handle of its instance."""
    return {"function": pointer(call.func), "component": addressof(call.args[0])}


def evaluation(call: Evaluation, when: When, owner: int, again: Reevaluation | None = None) -> Instruction:
    """Evaluates the equations of a block; with ``again`` only if its inputs have changed."""
    pointers: dict[str, int | None] = {"function": call.function, "component": addressof(call.argument)}
    packed = Instruction(Opcode.EVALUATE, when, owner, _never, {}, pointers, (call,))
    if again is not None:
        packed.numbers["count"] = again.inputs.size
        packed.addresses |= {"source": address(again.inputs), "target": address(again.seen)}
        packed.kept = (call, again)
    return packed


def sample_step(call: SampleStep, when: When, owner: int) -> Instruction:
    """fmi2DoStep of a sampled FMU to its sample instant, or of a task from it."""
    kind = Opcode.TASK if call.is_task else Opcode.SAMPLE
    pointers = {**_reached(call.step), "target": address(call.state)}
    return Instruction(kind, when, owner, lambda status, begin, end: call.failure(status, end), {}, pointers, (call,))


def copy(source: RealArray, target: RealArray, when: When, owner: int, stride: int = 0) -> Instruction:
    """Copies ``source`` into ``target``, which are contiguous; with a stride from row ``point`` of a table."""
    numbers = {"count": target.size, "stride": stride}
    pointers: dict[str, int | None] = {"source": address(source), "target": address(target)}
    return Instruction(Opcode.COPY, when, owner, _never, numbers, pointers, (source, target))


def gather(
    source: RealArray, columns: Indices, target: RealArray, places: Indices, when: When, owner: int, stride: int = 0
) -> Instruction:
    """``target.flat[places] = source.flat[columns]``; one copy if both are consecutive.

    With a stride ``source`` is a table, and the columns count from the beginning of its row ``point``.
    """
    flat = source.reshape(-1), target.reshape(-1)
    if is_range(columns) and is_range(places):
        return copy(flat[0][columns[0] :], flat[1][places[0] : places[-1] + 1], when, owner, stride)
    columns, places = (np.ascontiguousarray(each, dtype=np.int64) for each in (columns, places))
    pointers: dict[str, int | None] = {
        "source": address(source),
        "columns": address(columns),
        "target": address(target),
        "places": address(places),
    }
    kept = (source, columns, target, places)
    numbers = {"count": columns.size, "stride": stride}
    return Instruction(Opcode.GATHER, when, owner, _never, numbers, pointers, kept)


def combine(kind: Opcode, source: RealArray, target: RealArray, places: Indices, when: When, owner: int) -> Instruction:
    """``target.flat[places] *= source`` or ``+= source``, by the kind; the source doesn't change."""
    source, places = np.ascontiguousarray(source), np.ascontiguousarray(places, dtype=np.int64)
    pointers: dict[str, int | None] = {
        "source": address(source),
        "target": address(target),
        "places": address(places),
    }
    return Instruction(kind, when, owner, _never, {"count": places.size}, pointers, (source, target, places))


def finite(signals: RealArray, when: When, owner: int, failure: Failure) -> Instruction:
    """Fails if a signal isn't finite."""
    return Instruction(
        Opcode.FINITE, when, owner, failure, {"count": signals.size}, {"target": address(signals)}, (signals,)
    )


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
    pointers: dict[str, int | None] = {"function": pointer(callback)}
    return Instruction(Opcode.CALL, when, owner, failure, {}, pointers, (callback,))


def pointer(function: Any) -> int | None:
    """Address of a C function."""
    address_of: int | None = cast(function, c_void_p).value
    return address_of


def flags(values: Sequence[bool] | NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Flags as bytes, as C reads them."""
    return np.array(values, dtype=c_ubyte)


def _never(status: int, begin: float, end: float) -> BaseException:
    """The `Failure` of instructions that can't fail."""
    return AssertionError(f"status {status} of an instruction that can't fail")
