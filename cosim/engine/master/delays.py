"""The delay of each connection, and its cause."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import inf

import numpy as np

from flexfmu.cosim.engine.master.couplings import Coupling, Couplings, Transport
from flexfmu.cosim.engine.master.plan import sampling_positions
from flexfmu.cosim.engine.master.system import Connection, System, in_one_call
from flexfmu.cosim.engine.slave import Sampled, Slave, offset

ROUNDING = 1e-9
"""Instants that differ by less than this fraction of a sample time coincide."""


@dataclass(frozen=True)
class SignalDelay:
    """Delay of a connection.

    Attributes:
        connection: ``plant.y -> controller.u``.
        seconds: greatest age of the signal at the target [s]: zero; the largest communication step of the run if it is
            extrapolated; or, between two sampled slaves, the time since the source's last sample.
        mean: the same on average over the samples of a sampled target [s].
        transport: how the target gets the signal.
        derivatives: number of derivatives that extrapolate the signal and compensate for its age.
        hold: sample time of a sampled source whose target is stepped [s]; half of it is delay on average.
        latency: delay of the source's output behind its inputs at low frequency [s], as of a dead time or a lag.
    """

    connection: str
    seconds: float
    transport: Transport
    derivatives: int
    hold: float = 0.0
    latency: float = 0.0
    mean: float = 0.0

    @property
    def average(self) -> float:
        """Total delay on average [s]: the latency, half of the hold, and the age.

        Of an extrapolated signal half the age counts, or nothing if derivatives are passed.
        """
        extrapolated = self.transport is Transport.EXTRAPOLATED
        age = self.seconds * (0.0 if self.derivatives else 0.5) if extrapolated else self.mean
        return self.latency + 0.5 * self.hold + age

    def __str__(self) -> str:
        """The delay in words, one line."""
        own = f"; its source itself lags by {self.latency:.6g} s" if self.latency else ""
        return f"{self.connection}: {self._way()}{own}"

    def _way(self) -> str:
        """The delay between source and target in words."""
        # sample and hold, no delay, an older sample, extrapolation
        if self.hold:
            return (
                f"{0.5 * self.hold:.6g} s late on average, held for {self.hold:.6g} s between the samples of its source"
            )
        if self.seconds == 0.0:
            return f"no delay, {self.transport.value}"
        if self.transport is not Transport.EXTRAPOLATED:
            more = f" on average, {self.seconds:.6g} s at most" if self.seconds > self.mean * (1.0 + ROUNDING) else ""
            return f"{self.mean:.6g} s late{more}, its source has sampled that long before its target"
        if self.derivatives:
            known = f"{self.derivatives} derivative{'s' if self.derivatives > 1 else ''}"
            return f"up to {self.seconds:.6g} s old, {self.transport.value} with {known}"
        return f"up to {self.seconds:.6g} s late, held over the step"


def signal_delays(system: System, couplings: Couplings, step: float) -> tuple[SignalDelay, ...]:
    """The delay of each connection of the system, in their order.

    Args:
        system: slaves and connections.
        couplings: (source, target) → their coupling.
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
    seconds, mean, hold = step if coupling.transport is Transport.EXTRAPOLATED else 0.0, 0.0, 0.0
    # a source with given instants is never late; a sampled target may use an older sample; a stepped target sees it held
    if isinstance(source, Sampled) and source.sample_time == inf:
        pass
    elif isinstance(source, Sampled) and isinstance(target, Sampled):
        sampled_later = in_one_call(source) and positions[connection.source] >= positions[connection.target]
        seconds, mean = _ages(source, target, sampled_later)
    elif isinstance(source, Sampled):
        hold = source.sample_time
    # latency of the source itself
    latencies: Mapping[str, float] = getattr(source, "latency", {})
    latency = latencies.get(source.variables[connection.output].name, 0.0)
    return SignalDelay(system.describe(connection), seconds, coupling.transport, coupling.order, hold, latency, mean)


COUNTED = 1000
"""Number of target instants compared; the pattern repeats within it, see `flexfmu.cosim.engine.master.grid`."""


def _ages(source: Slave, target: Slave, late: bool) -> tuple[float, float]:
    """Longest and mean time between a sample of the target and the source's last sample before it [s].

    Args:
        source, target: slaves that sample.
        late: whether the source samples after the target when both sample at the same instant.
    """
    assert isinstance(source, Sampled)
    assert isinstance(target, Sampled)
    period = source.sample_time
    since = np.mod(offset(target) - offset(source) + target.sample_time * np.arange(COUNTED), period) / period
    together = (since < ROUNDING) | (since > 1.0 - ROUNDING)
    ages = period * np.where(together, 1.0 if late else 0.0, since)
    # the mean of whole patterns
    pattern = Fraction(period / target.sample_time).limit_denominator(COUNTED).numerator
    return float(ages.max()), float(ages[:pattern].mean())
