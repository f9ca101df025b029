"""Which signals arrive late, by how much and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexfmu.cosim.engine.master.couplings import Coupling, Couplings, Transport
from flexfmu.cosim.engine.master.dependencies import Connection, in_one_call
from flexfmu.cosim.engine.master.plan import sampling_positions
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.slave import HasLatency, Sampled, Slave, offset

ROUNDING = 1e-9
"""Instants nearer than this fraction of a sample time are one."""


@dataclass(frozen=True)
class SignalDelay:
    """How late a signal arrives.

    Attributes:
        connection: ``plant.y -> controller.u``.
        seconds: age of what the target knows of the signal, at most [s]: zero, one communication step (the largest of
            the run), or for a target that samples how long ago its source has sampled.
        transport: how the signal gets there.
        derivatives: how many derivatives of the signal go with it, to make up for its age.
        hold: how long a sampled source holds the signal for a target that is stepped [s]; on average half of it is delay.
        latency: by how much the source itself lags behind its inputs at low frequency [s], as delays and lags do.
    """

    connection: str
    seconds: float
    transport: Transport
    derivatives: int
    hold: float = 0.0
    latency: float = 0.0

    @property
    def average(self) -> float:
        """The whole delay on average [s]: the source's own, half of what is held, and age without derivatives."""
        extrapolated = self.transport is Transport.EXTRAPOLATED
        age = self.seconds * ((0.0 if self.derivatives else 0.5) if extrapolated else 1.0)
        return self.latency + 0.5 * self.hold + age

    def __str__(self) -> str:
        """The delay in words, one line."""
        own = f"; its source itself lags by {self.latency:.6g} s" if self.latency else ""
        return f"{self.connection}: {self._way()}{own}"

    def _way(self) -> str:
        """What happens between source and target."""
        # from the longest delay to none
        if self.hold:
            return (
                f"{0.5 * self.hold:.6g} s late on average, held for {self.hold:.6g} s between the samples of its source"
            )
        if self.seconds == 0.0:
            return f"no delay, {self.transport.value}"
        if self.transport is not Transport.EXTRAPOLATED:
            return f"{self.seconds:.6g} s late, its source has sampled that long before its target"
        if self.derivatives:
            known = f"{self.derivatives} derivative{'s' if self.derivatives > 1 else ''}"
            return f"up to {self.seconds:.6g} s old, {self.transport.value} with {known}"
        return f"up to {self.seconds:.6g} s late, held over the step"


def signal_delays(system: System, couplings: Couplings, step: float) -> tuple[SignalDelay, ...]:
    """For each connection of the system how late its signals arrive.

    Args:
        system: the system.
        couplings: (source, target) → how signals get there.
        step: the largest communication step [s].
    """
    positions = sampling_positions(system)
    return tuple(
        _delay(system, each, couplings[each.source, each.target], positions, step) for each in system.connections
    )


def _delay(
    system: System, connection: Connection, coupling: Coupling, positions: Mapping[int, int], step: float
) -> SignalDelay:
    """The delay of one connection."""
    source, target = system.slaves[connection.source], system.slaves[connection.target]
    seconds, hold = step if coupling.transport is Transport.EXTRAPOLATED else 0.0, 0.0
    # a sample may be older than its target's instant, and is held for those that are stepped
    if isinstance(source, Sampled) and isinstance(target, Sampled):
        sampled_later = in_one_call(source) and positions[connection.source] >= positions[connection.target]
        seconds = _age(source, target, sampled_later)
    elif isinstance(source, Sampled):
        hold = source.sample_time
    # what the source itself adds
    latencies = source.latency if isinstance(source, HasLatency) else {}
    latency = latencies.get(source.variables[connection.output].name, 0.0)
    return SignalDelay(system.describe(connection), seconds, coupling.transport, coupling.order, hold, latency)


COUNTED = 1000
"""Instants of a target that are looked at; their pattern repeats after no more, see `flexfmu.cosim.engine.master.grid`."""


def _age(source: Slave, target: Slave, late: bool) -> float:
    """How long ago a source has sampled when its target does, at most [s].

    Args:
        source, target: slaves that sample.
        late: whether the source samples after the target where both sample at one instant.
    """
    assert isinstance(source, Sampled)
    assert isinstance(target, Sampled)
    period = source.sample_time
    since = np.mod(offset(target) - offset(source) + target.sample_time * np.arange(COUNTED), period) / period
    together = (since < ROUNDING) | (since > 1.0 - ROUNDING)
    return period * float(np.where(together, 1.0 if late else 0.0, since).max())
