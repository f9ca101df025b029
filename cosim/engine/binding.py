"""Calls that transfer values between fixed variables and fixed buffers; bound once if the slave is a `BindsBuffers`."""

from __future__ import annotations

from typing import cast

import numpy as np

from flexfmu.cosim.engine.slave import (
    BindsBuffers,
    Call,
    GivesOutputDerivatives,
    Indices,
    RealArray,
    Slave,
    TakesInputDerivatives,
)


def bind_set(slave: Slave, indices: Indices, signals: RealArray) -> Call:
    """Return a call that sets inputs from ``signals`` (orders + 1, n); row k has the k-th derivatives."""
    values, derivatives = signals[0], signals[1:]
    if isinstance(slave, BindsBuffers):
        set_values = slave.bind_set(indices, values)
        return Both(set_values, slave.bind_set_derivatives(indices, derivatives)) if len(derivatives) else set_values
    if not len(derivatives):
        return lambda: slave.set(indices, values)
    taker = cast(TakesInputDerivatives, slave)
    return Both(lambda: slave.set(indices, values), lambda: taker.set_derivatives(indices, derivatives))


def bind_get(slave: Slave, indices: Indices, signals: RealArray) -> Call:
    """Return a call that reads outputs into ``signals`` (orders + 1, n); row k has the k-th derivatives."""
    values, derivatives = signals[0], signals[1:]
    if isinstance(slave, BindsBuffers):
        get_values = slave.bind_get(indices, values)
        return Both(get_values, slave.bind_get_derivatives(indices, derivatives)) if len(derivatives) else get_values
    if not len(derivatives):
        return lambda: slave.get(indices, values)
    giver = cast(GivesOutputDerivatives, slave)
    return Both(lambda: slave.get(indices, values), lambda: giver.get_derivatives(indices, derivatives))


class Both:
    """Two calls in sequence as one call."""

    __slots__ = ("first", "second")

    def __init__(self, first: Call, second: Call) -> None:
        self.first, self.second = first, second

    def __call__(self) -> None:
        self.first()
        self.second()


class Copy:
    """A call that copies ``source`` (n,) to the elements ``indices`` of ``target``.

    Attributes:
        source, target: the buffers.
        place: elements of the target; a slice if the indices are consecutive.
        is_contiguous: whether source and destination are contiguous blocks of memory.
    """

    __slots__ = ("is_contiguous", "place", "source", "target")

    def __init__(self, source: RealArray, target: RealArray, indices: Indices) -> None:
        self.source, self.target = source, target
        self.place = slice(int(indices[0]), int(indices[-1]) + 1) if is_range(indices) else indices
        self.is_contiguous = is_range(indices) and source.flags.c_contiguous and target.flags.c_contiguous

    def __call__(self) -> None:
        self.target[self.place] = self.source


def is_range(indices: Indices) -> bool:
    """Return whether the indices are consecutive; False if there are none."""
    return bool(indices.size and (np.diff(indices) == 1).all())


def nothing() -> None:
    """Do nothing: the call of a transfer without variables."""
