"""Which signals arrive late, by how much and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flexfmu.cosim.master.dependencies import Connection, in_one_call
from flexfmu.cosim.master.links import Coupling, Couplings, Transport
from flexfmu.cosim.master.system import System
from flexfmu.cosim.master.visit import sampling_turns
from flexfmu.cosim.slave import Sampled


@dataclass(frozen=True)
class SignalDelay:
    """How late a signal arrives.

    Attributes:
        connection: ``plant.y -> controller.u``.
        seconds: age of what the target knows of the signal, at most [s]: zero, one communication step (the largest of
            the run), or one sample of the source.
        transport: how the signal gets there.
        derivatives: how many derivatives of the signal go with it, to make up for its age.
    """

    connection: str
    seconds: float
    transport: Transport
    derivatives: int

    def __str__(self) -> str:
        """The delay in words, one line."""
        if self.seconds == 0.0:
            return f"{self.connection}: no delay, {self.transport.value}"
        if self.transport is not Transport.EXTRAPOLATED:
            return f"{self.connection}: {self.seconds:.6g} s late, its source samples after its target"
        if self.derivatives:
            known = f"{self.derivatives} derivative{'s' if self.derivatives > 1 else ''}"
            return f"{self.connection}: up to {self.seconds:.6g} s old, {self.transport.value} with {known}"
        return f"{self.connection}: up to {self.seconds:.6g} s late, held over the step"


def signal_delays(system: System, couplings: Couplings, step: float) -> tuple[SignalDelay, ...]:
    """For each connection of the system how late its signals arrive.

    Args:
        system: the system.
        couplings: (source, target) → how signals get there.
        step: the largest communication step [s].
    """
    turns = sampling_turns(system)
    return tuple(_delay(system, each, couplings[each.source, each.target], turns, step) for each in system.connections)


def _delay(
    system: System, connection: Connection, coupling: Coupling, turns: Mapping[int, int], step: float
) -> SignalDelay:
    """The delay of one connection."""
    source, target = system.slaves[connection.source], system.slaves[connection.target]
    seconds = step if coupling.transport is Transport.EXTRAPOLATED else 0.0
    sampled_later = turns[connection.source] >= turns[connection.target] and isinstance(target, Sampled)
    if isinstance(source, Sampled) and in_one_call(source) and sampled_later:
        seconds = source.sample_time
    return SignalDelay(system.describe(connection), seconds, coupling.transport, coupling.order)
