"""Calls with fixed buffers: transfers of values, bound once if the slave is a `BindsBuffers`, and what a sample consists of.

The loop in C makes most of them without Python.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_void_p
from functools import partial
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from flexfmu.cosim.engine.slave import BindsBuffers, Call, Indices, RealArray, Slave


def bind(slave: Slave, direction: Literal["set", "get"], indices: Indices, signals: RealArray) -> Call:
    """Return a call that sets inputs from ``signals`` (orders + 1, n), or gets outputs into them; row k has the k-th derivatives."""
    parts: dict[str, RealArray] = {direction: signals[0]}
    if len(signals) > 1:
        parts[f"{direction}_derivatives"] = signals[1:]
    if isinstance(slave, BindsBuffers):
        calls: list[Call] = [getattr(slave, f"bind_{name}")(indices, buffer) for name, buffer in parts.items()]
    else:
        calls = [partial(getattr(slave, name), indices, buffer) for name, buffer in parts.items()]
    return Both(*calls) if len(calls) > 1 else calls[0]


class Both:
    """Two calls in sequence as one call."""

    __slots__ = ("first", "second")

    def __init__(self, first: Call, second: Call) -> None:
        self.first, self.second = first, second

    def __call__(self) -> None:
        self.first()
        self.second()


class Copy:
    """A call that copies ``source`` (n,) to the elements ``indices`` of ``target``."""

    __slots__ = ("_place", "indices", "source", "target")

    def __init__(self, source: RealArray, target: RealArray, indices: Indices) -> None:
        self.source, self.target, self.indices = source, target, indices
        self._place = slice(int(indices[0]), int(indices[-1]) + 1) if is_range(indices) else indices

    def __call__(self) -> None:
        self.target[self._place] = self.source


class Take:
    """A call that writes the elements ``indices`` of ``source`` into ``target`` (n,)."""

    __slots__ = ("_take", "indices", "source", "target")

    def __init__(self, source: RealArray, indices: Indices, target: RealArray) -> None:
        self.source, self.indices, self.target = source, indices, target
        self._take = partial(source.take, indices, None, target, "clip")

    def __call__(self) -> None:
        self._take()


class Refresh:
    """A call that takes values and sends them, unless they are those sent last.

    Attributes:
        take: takes the values.
        send: sends them.
    """

    __slots__ = ("send", "take")

    def __init__(self, take: Take, send: Call) -> None:
        self.take, self.send = take, send

    def __call__(self) -> None:
        if self.take.source[self.take.indices].tobytes() != self.take.target.tobytes():
            self.take()
            self.send()


class Evaluation:
    """A call of ``void function(void *argument)`` in C, which needs no Python and raises nothing.

    Attributes:
        function: address of the function.
        argument: its argument, which lives as long as the slave.
    """

    __slots__ = ("_call", "argument", "function")

    def __init__(self, function: int, argument: int, call: Call) -> None:
        self.function, self.argument, self._call = function, c_void_p(argument), call

    def __call__(self) -> None:
        self._call()


class Reevaluation:
    """An evaluation that the loop in C makes only if inputs have changed since the last one.

    Attributes:
        evaluation: the evaluation.
        inputs, seen: the inputs (n,), and those of the last evaluation.
    """

    __slots__ = ("evaluation", "inputs", "seen")

    def __init__(self, evaluation: Evaluation, inputs: RealArray, seen: RealArray) -> None:
        self.evaluation, self.inputs, self.seen = evaluation, inputs, seen


class SampleStep:
    """A call of fmi2DoStep at a sample instant.

    Attributes:
        step: fmi2DoStep with its component bound.
        state: {time reached, step, or 0 up to the instant} of a step to the instant, or {first instant, sample time,
            number of steps} of a task, which steps from the instant to the next one.
    """

    __slots__ = ("_error", "state", "step")

    def __init__(
        self, step: partial[int], error: Callable[[int, float, float], BaseException], state: RealArray
    ) -> None:
        self.step, self._error, self.state = step, error, state

    @property
    def is_task(self) -> bool:
        """Whether it steps from the sample instant."""
        return self.state.size == TASK_NUMBERS

    def failure(self, status: int, begin: float, time: float) -> BaseException:
        """The error of a step that failed at the instant ``time`` [s]."""
        first, step, *count = self.state.tolist()
        if count:
            return self._error(status, first + count[0] * step, step)
        return self._error(status, first, step or time - first)


TASK_NUMBERS = 3
"""Size of the state of a task's step; that of a step to the instant is smaller by one."""

SampleCall = SampleStep | Reevaluation | Call
"""What a sample consists of."""

Phase = Literal["sample", "output", "update"]
"""What is calculated at a sample instant, as in `flexfmu.cosim.engine.slave.SamplesInTwoPhases`."""


@runtime_checkable
class SamplesInC(Protocol):
    """Can be sampled by calls that the loop in C makes: `Evaluation`, `Reevaluation`, `SampleStep`, `Copy`, `Take`, `Refresh`, FMI transfers."""

    def sample_calls(self, phase: Phase) -> tuple[SampleCall, ...] | None:
        """The calls that do what the method ``phase`` does; None if it takes Python. The slave has been initialised."""


def is_range(indices: Indices) -> bool:
    """Return whether the indices are consecutive; False if there are none."""
    return bool(indices.size and (np.diff(indices) == 1).all())


def nothing() -> None:
    """Do nothing: the call of a transfer without variables."""
