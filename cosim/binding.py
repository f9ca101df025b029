"""Transfers between fixed variables and fixed buffers, bound where the slave can bind them."""

from __future__ import annotations

from typing import cast

from flexfmu.cosim.slave import (
    BindsBuffers,
    Call,
    GivesOutputDerivatives,
    Indices,
    RealArray,
    Slave,
    TakesInputDerivatives,
)


def bind_set(slave: Slave, indices: Indices, signals: RealArray) -> Call:
    """A call that sets inputs from ``signals`` (orders + 1, n): values in row 0, derivatives below."""
    values, derivatives = signals[0], signals[1:]
    if isinstance(slave, BindsBuffers):
        set_values = slave.bind_set(indices, values)
        return both(set_values, slave.bind_set_derivatives(indices, derivatives)) if len(derivatives) else set_values
    if not len(derivatives):
        return lambda: slave.set(indices, values)
    taker = cast(TakesInputDerivatives, slave)
    return both(lambda: slave.set(indices, values), lambda: taker.set_derivatives(indices, derivatives))


def bind_get(slave: Slave, indices: Indices, signals: RealArray) -> Call:
    """A call that reads outputs into ``signals`` (orders + 1, n): values in row 0, derivatives below."""
    values, derivatives = signals[0], signals[1:]
    if isinstance(slave, BindsBuffers):
        get_values = slave.bind_get(indices, values)
        return both(get_values, slave.bind_get_derivatives(indices, derivatives)) if len(derivatives) else get_values
    if not len(derivatives):
        return lambda: slave.get(indices, values)
    giver = cast(GivesOutputDerivatives, slave)
    return both(lambda: slave.get(indices, values), lambda: giver.get_derivatives(indices, derivatives))


def both(first: Call, second: Call) -> Call:
    """One call after the other."""

    def call() -> None:
        first()
        second()

    return call


def nothing() -> None:
    """A call that has nothing to transfer."""
