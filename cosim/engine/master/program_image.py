"""A run of a system as an image of memory for a WebAssembly module: the same instructions on the same buffers, for the same loop in C.

The module has the functions of one FMU, the equations of blocks, and ``master.c`` for all of them. What the image refers to is relocated
by its owner: addresses within the image by where it lies, functions by the module's table, tables of a trajectory and flags of sample
instants by where these lie. Initialisation is a script of such instructions and of the FMU's own calls.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Sequence
from ctypes import addressof, string_at
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from flexfmu.cosim.engine import binding
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.calls import address, value_references
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.compiled_loop import (
    Instruction,
    Opcode,
    evaluation,
    extrapolation,
    gather,
    pointer,
    table_row,
    transfer_of,
    translation,
)
from flexfmu.cosim.engine.master.ports import InputPort, OutputPort
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import Schedule, When
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave

FUNCTIONS = ("fmi2GetReal", "fmi2SetReal", "fmi2GetRealOutputDerivatives", "fmi2SetRealInputDerivatives", "fmi2DoStep")
"""Functions of the FMU that instructions call, by their number; those of blocks follow."""

LAYOUT = struct.Struct("<14I")
"""``master_instruction`` with addresses of four bytes."""

PLACES = {"references": 7, "orders": 8, "columns": 9, "places": 10, "source": 11, "target": 12}
"""Numbers of the fields that are addresses of data."""

FUNCTION, COMPONENT, DUE = 5, 6, 13
"""Numbers of the other fields that are addresses."""


@runtime_checkable
class EvaluatedInC(Protocol):
    """A sampled slave whose equations are one function (x, u, p) → (y, next x) on its own memory."""

    def reset(self) -> None:
        """Set start values of inputs and states, and zero elsewhere but for parameters."""

    def initial_call(self) -> binding.Evaluation | None:
        """The evaluation of the outputs at initialisation; None if C can't evaluate the block."""

    def buffers(self, call: binding.Evaluation) -> tuple[RealArray | None, ...]:
        """x, u, p, y and next x of an evaluation of this slave."""


@dataclass
class ProgramImage:
    """Memory and what is to be relocated in it; places are offsets in `data`.

    Attributes:
        data: content before initialisation.
        words: (place, base, offset) of words that are relocated: the offset from a base, which is ``image``, a table of the trajectory
            (``announced``, ``ended``) or a clock's flags (``due0``, ...); of the base ``function`` the offset is a number of `FUNCTIONS`, then
            of ``blocks``.
        advance, exchange: (place, number) of instructions.
        script: steps of initialisation: "create", "initialize" or (place, number) of instructions.
        handle: place of the FMU's instance.
        channels: (place, number) of recorded signals.
        blocks: indices of the slaves whose functions are called.
        parameters: parameter of a block, as ``slave.name`` → its place.
    """

    data: bytearray = field(default_factory=bytearray)
    words: list[tuple[int, str, int]] = field(default_factory=list)
    advance: tuple[int, int] = (0, 0)
    exchange: tuple[int, int] = (0, 0)
    script: list[Any] = field(default_factory=list)
    handle: int = 0
    channels: list[tuple[int, int]] = field(default_factory=list)
    blocks: list[int] = field(default_factory=list)
    parameters: dict[str, int] = field(default_factory=dict)

    def take(self, size: int) -> int:
        """Append so many bytes, zeros, and return their place."""
        place = len(self.data)
        self.data += bytes(-(-size // 8) * 8)
        return place

    def refer(self, place: int, target: int, base: str = "image") -> None:
        """Let the word at a place point to another one, from a base on."""
        self.words.append((place, base, target))


class _Builder:
    """Collects the memory that instructions refer to, then packs them."""

    def __init__(self, schedule: Schedule, plant: FmuSlave) -> None:
        self._schedule, self._image, self._clocks = schedule, ProgramImage(), list(schedule.due)
        self._calls = {pointer(plant._instance.calls[name]): number for number, name in enumerate(FUNCTIONS)}
        self._component = addressof(plant._instance.component)
        self._ranges: list[tuple[int, int]] = []
        self._begins: list[int] = []
        self._segments: list[tuple[int, int, int]] = []
        self._evaluations: dict[int, tuple[int, int]] = {}

    def image(self, recorder: Recorder) -> ProgramImage:
        image, schedule = self._image, self._schedule
        lists = [
            [each for operation in operations for each in translation(schedule, operation)]
            for operations in (schedule.plan.step, schedule.plan.exchange)
        ]
        start = [self._started(i) for i in schedule.plan.start]
        signals = [signals for signals, _ in recorder.blocks]
        # which memory there is, and its content before initialisation
        for each in [*lists[0], *lists[1], *(one for part in start for one in part if isinstance(one, Instruction))]:
            self._note(each)
        self._ranges += [(address(each), each.nbytes) for each in signals]
        for inputs, outputs in zip(schedule.inputs, schedule.outputs, strict=True):
            inputs.reset()
            outputs.reset()
        blocks: list[Any] = [slave for slave in schedule.slaves if isinstance(slave, EvaluatedInC)]
        for block in blocks:
            block.reset()
        self._lay_out()
        # instructions
        image.handle = image.take(8)
        image.advance, image.exchange = (self._packed(each, False) for each in lists)
        for part in start:
            run: list[Instruction] = []
            for step in (*part, None):
                if isinstance(step, Instruction):
                    run.append(step)
                    continue
                if run:
                    image.script.append(self._packed(run, True))
                image.script += [step] if step is not None else []
                run = []
        image.script.append(self._packed(lists[1], True))
        for i in image.blocks:
            slave = schedule.slaves[i]
            names = [each.name for each in slave.variables if each.causality == "parameter"]
            if isinstance(slave, EvaluatedInC) and (call := slave.initial_call()) is not None and names:
                parameters = slave.buffers(call)[2]
                assert parameters is not None
                first = self._place(address(parameters))
                image.parameters |= {f"{slave.name}.{name}": first + 8 * k for k, name in enumerate(names)}
        image.channels = [(self._place(address(each)), each.size) for each in signals]
        return image

    def _started(self, i: int) -> list[Instruction | str]:
        """Initialisation of a slave: inputs from those before it, its own calls, its outputs."""
        schedule, slave = self._schedule, self._schedule.slaves[i]
        inputs, outputs, always = schedule.inputs[i], schedule.outputs[i], When.ALWAYS
        before = schedule.plan.start[: schedule.plan.start.index(i)]
        groups = [each for each in inputs.groups if any(each.source is schedule.outputs[k] for k in before)]
        found: list[Instruction | str] = []
        for group in groups:
            found += extrapolation(group, inputs.fed, always, i)
        match slave:
            case TrajectorySlave():
                return [table_row(lambda: slave.ended, outputs, i, outputs.recorded)]
            case FmuSlave():
                sent = [self._sent(slave, inputs, group.slots, i) for group in groups]
                return ["create", *found, *sent, "initialize", *self._read(outputs, i)]
            case EvaluatedInC():
                memory = slave.buffers(call)[1] if (call := slave.initial_call()) is not None else None
                if call is None or memory is None:
                    raise InputError(f"the equations of {slave.name!r} can't be called from C")
                for group in groups:
                    indices = inputs._indices[group.slots]
                    columns = np.arange(inputs.fed.shape[1])[group.slots]
                    found.append(gather(inputs.fed, columns, memory, indices, always, i))
                return [*found, evaluation(call, always, i), *self._read(outputs, i)]
        raise InputError(f"{slave.name!r} is a {type(slave).__name__}")

    @staticmethod
    def _read(outputs: OutputPort, i: int) -> Sequence[Instruction]:
        return list(transfer_of(outputs.transfer, When.ALWAYS, i)) if outputs.indices.size else []

    def _sent(self, plant: FmuSlave, inputs: InputPort, slots: slice, i: int) -> Instruction:
        """Sets inputs of the FMU before its initialisation."""
        references = value_references([plant._handles[k].reference for k in inputs._indices[slots]])
        function = next(k for k, n in self._calls.items() if FUNCTIONS[n] == "fmi2SetReal")
        return Instruction(
            Opcode.VALUES,
            When.ALWAYS,
            i,
            count=references.size,
            references=references,
            target=inputs.fed[0, slots],
            component=self._component,
            function=function,
        )

    def _note(self, each: Instruction) -> None:
        """Take down the memory of an instruction."""
        fields, count = each.fields, each.fields.get("count", 0)
        if each.kind in (Opcode.CALL, Opcode.SAMPLE, Opcode.TASK, Opcode.REFRESH):
            raise InputError(f"{self._schedule.slaves[each.owner].name!r} runs in Python or in a foreign FMU")
        sizes = {"references": 4 * count, "orders": 4 * count, "columns": 8 * count, "places": 8 * count}
        sizes |= {"source": 8 * count, "target": 8 * count}
        for name, indices in (("source", "columns"), ("target", "places")):
            if indices in fields:
                sizes[name] = 8 * (int(fields[indices].max(initial=-1)) + 1)
        if each.table is not None:
            del sizes["source"]
        for name, size in sizes.items():
            if name in fields:
                self._ranges.append((_address(fields[name]), size))
        if each.kind is Opcode.EVALUATE:
            slave, call = self._schedule.slaves[each.owner], each._kept
            assert isinstance(slave, EvaluatedInC)
            assert isinstance(call, binding.Evaluation)
            self._ranges += [(address(b), b.nbytes) for b in slave.buffers(call) if b is not None and b.size]

    def _lay_out(self) -> None:
        """Copy all memory, overlapping ranges as one, into the image."""
        merged: list[list[int]] = []
        for begin, size in sorted(self._ranges):
            if merged and begin < merged[-1][1]:
                merged[-1][1] = max(merged[-1][1], begin + size)
            elif size:
                merged.append([begin, begin + size])
        for begin, end in merged:
            place = self._image.take(end - begin)
            self._image.data[place : place + end - begin] = string_at(begin, end - begin)
            self._segments.append((begin, end, place))
        self._begins = [begin for begin, _, _ in self._segments]

    def _place(self, where: int) -> int:
        begin, end, place = self._segments[bisect_right(self._begins, where) - 1]
        assert begin <= where < end
        return place + where - begin

    def _packed(self, instructions: Sequence[Instruction], initial: bool) -> tuple[int, int]:
        """Write instructions; their place and number."""
        image = self._image
        first = image.take(LAYOUT.size * max(len(instructions), 1))
        for number, each in enumerate(instructions):
            fields, at = each.fields, first + LAYOUT.size * number
            words = [each.kind, each.when, each.owner, fields.get("count", 0), fields.get("stride", 0), *[0] * 9]
            LAYOUT.pack_into(image.data, at, *words)
            for name, index in PLACES.items():
                if name == "source" and each.table is not None:
                    row = fields["stride"]
                    table = "announced" if row == self._announced_row(each.owner) else "ended"
                    image.refer(at + 4 * index, each.offset - (8 * row if initial else 0), table)
                elif name in fields and fields.get("count", 0):
                    image.refer(at + 4 * index, self._place(_address(fields[name])))
            if "due" in fields:
                image.refer(at + 4 * DUE, -1 if initial else 0, f"due{self._clocks.index(each.owner)}")
            if each.kind is Opcode.EVALUATE:
                number_of, slot = self._evaluation(each)
                image.refer(at + 4 * FUNCTION, number_of, "function")
                image.refer(at + 4 * COMPONENT, slot)
            elif "function" in fields:
                if fields["component"] != self._component:
                    raise InputError(f"{self._schedule.slaves[each.owner].name!r} is a further FMU")
                image.refer(at + 4 * FUNCTION, self._calls[fields["function"]], "function")
                image.refer(at + 4 * COMPONENT, image.handle)
        return first, len(instructions)

    def _announced_row(self, owner: int) -> int:
        slave = self._schedule.slaves[owner]
        assert isinstance(slave, TrajectorySlave)
        return int(np.prod(slave.announced.shape[1:]))

    def _evaluation(self, each: Instruction) -> tuple[int, int]:
        """Number of a block's function, and the place that points to the addresses of its buffers."""
        image, call = self._image, each._kept
        assert isinstance(call, binding.Evaluation)
        slave = self._schedule.slaves[each.owner]
        assert isinstance(slave, EvaluatedInC)
        key = call.argument.value or 0
        if key not in self._evaluations:
            if each.owner not in image.blocks:
                image.blocks.append(each.owner)
            slot, where = image.take(8), image.take(4 * 5)
            image.refer(slot, where)
            for k, buffer in enumerate(slave.buffers(call)):
                if buffer is not None and buffer.size:
                    image.refer(where + 4 * k, self._place(address(buffer)))
            self._evaluations[key] = image.blocks.index(each.owner) + len(FUNCTIONS), slot
        return self._evaluations[key]


def _address(value: Any) -> int:
    return address(value) if isinstance(value, np.ndarray) else int(value)


def program_image(schedule: Schedule, recorder: Recorder) -> ProgramImage:
    """The image of a run, of a schedule whose slaves have been initialised once and are terminated; signals and blocks are reset.

    Raises:
        InputError: a slave isn't one FMU 2.0, a block or a trajectory, or takes Python; the message names it.
    """
    plants = [each for each in schedule.slaves if isinstance(each, FmuSlave)]
    if len(plants) != 1:
        raise InputError(f"there are {len(plants)} FMUs: {', '.join(repr(each.name) for each in plants)}")
    return _Builder(schedule, plants[0]).image(recorder)
