"""The error of the coupling over a step, from one step and two halves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexfmu.cosim.links import Coupling, Couplings, Transport
from flexfmu.cosim.ports import OutputPort
from flexfmu.cosim.slave import KnowsItsFuture, RealArray, Sampled
from flexfmu.cosim.step_control import StepDoubling
from flexfmu.cosim.system import System

WATCHED_ROWS = 2
"""Values and first derivatives are watched."""


@dataclass(frozen=True)
class Watched:
    """Signals of a port whose error counts: some columns of its first rows."""

    port: OutputPort
    columns: Sequence[int]
    rows: int

    def signals(self) -> RealArray:
        """(n,) the current signals."""
        return np.asarray(self.port.signals[: self.rows, self.columns]).ravel()

    def names(self) -> list[str]:
        """Their names."""
        slave = self.port.slave
        names = [f"{slave.name}.{slave.variables[self.port.indices[column]].name}" for column in self.columns]
        return names + [f"der({name})" for name in names if self.rows == WATCHED_ROWS]


class CouplingError:
    """Compares signals with each other and with what they may differ.

    Attributes:
        order: power of the step that the error per unit step goes with.
    """

    def __init__(
        self,
        system: System,
        ports: Sequence[OutputPort],
        couplings: Couplings,
        control: StepDoubling,
        span: float,
    ) -> None:
        self._control = control
        self._span = span
        self._watched = [_watch(system, i, ports[i]) for i in sorted({each.source for each in system.connections})]
        self._names = [name for each in self._watched for name in each.names()]
        self.order = 1 + min(map(_degree, filter(_counts, couplings.values())), default=0)
        self._scale = np.zeros(len(self._names))

    def signals(self) -> RealArray:
        """(n,) the current signals."""
        return np.concatenate([np.empty(0), *(each.signals() for each in self._watched)])

    def learn(self) -> None:
        """Take the current signals into account for the magnitudes."""
        np.maximum(self._scale, abs(self.signals()), self._scale)

    def compare(self, at_once: RealArray, step: float) -> tuple[float, str]:
        """The error of the current signals, which came from two halves, over the allowed one, and whose it is.

        Args:
            at_once: (n,) signals from one step.
            step: its length [s].
        """
        if not self._names:
            return 0.0, ""
        halves = self.signals()
        error = abs(halves - at_once) / (2.0**self.order - 1.0)
        scale = np.maximum(self._scale, abs(halves))
        allowed = (self._control.tolerance * scale + self._control.absolute) * (step / self._span)
        ratio = np.divide(error, allowed, out=np.where(error > 0.0, np.inf, 0.0), where=allowed > 0.0)
        worst = int(np.argmax(ratio))
        return float(ratio[worst]), self._names[worst]


def _watch(system: System, source: int, port: OutputPort) -> Watched:
    """The connected outputs of a slave, none of one that has no error."""
    if isinstance(port.slave, KnowsItsFuture | Sampled):
        return Watched(port, [], 1)
    outputs = sorted({each.output for each in system.connections if each.source == source})
    return Watched(port, np.searchsorted(port.indices, outputs).tolist(), min(port.recorded, WATCHED_ROWS))


def _counts(coupling: Coupling) -> bool:
    """Whether the coupling has an error that depends on the step."""
    return coupling.transport in (Transport.EXTRAPOLATED, Transport.INTERPOLATED, Transport.AVERAGED)


def _degree(coupling: Coupling) -> int:
    """Degree of the polynomials."""
    if coupling.transport is Transport.AVERAGED:
        return 1
    return coupling.order if coupling.ends is None else 2 * coupling.ends + 1
