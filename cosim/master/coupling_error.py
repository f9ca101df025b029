"""The error of the coupling over a step, from one step and two halves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from flexfmu.cosim.errors import InputError
from flexfmu.cosim.master.links import Coupling, Couplings, Transport
from flexfmu.cosim.master.ports import OutputPort
from flexfmu.cosim.master.step_control import StepDoubling
from flexfmu.cosim.master.system import System
from flexfmu.cosim.slave import RealArray

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

    def magnitudes(self, span: float) -> RealArray:
        """(n,) their magnitudes, a derivative's at least that of its signal over ``span`` [s]."""
        rows = abs(self.port.signals[: self.rows, self.columns])
        if self.rows == WATCHED_ROWS:
            np.maximum(rows[1], rows[0] / span, out=rows[1])
        return np.asarray(rows).ravel()

    def names(self) -> list[str]:
        """Their names."""
        slave = self.port.slave
        names = [f"{slave.name}.{slave.variables[self.port.indices[column]].name}" for column in self.columns]
        return names + [f"der({name},1)" for name in names if self.rows == WATCHED_ROWS]


class CouplingError:
    """Compares signals with each other and with what they may differ.

    Attributes:
        order: power of the step that the error per unit step goes with.
    """

    def __init__(
        self, system: System, ports: Sequence[OutputPort], couplings: Couplings, control: StepDoubling, span: float
    ) -> None:
        self._control = control
        self._span = span
        if control.signals is None:
            self._watched = _watched_by_default(system, ports, couplings)
        else:
            self._watched = [_find(ports, name) for name in control.signals]
        self._names = [name for each in self._watched for name in each.names()]
        self.order = 1 + min(map(_degree, filter(_counts, couplings.values())), default=0)
        self._scale = np.zeros(len(self._names))

    def signals(self) -> RealArray:
        """(n,) the current signals."""
        return np.concatenate([np.empty(0), *(each.signals() for each in self._watched)])

    def learn(self) -> None:
        """Take the current signals into account for the magnitudes."""
        np.maximum(self._scale, self._magnitudes(), out=self._scale)

    def _magnitudes(self) -> RealArray:
        """(n,) magnitudes of the current signals; a derivative's is at least what changes its signal once in a run."""
        return np.concatenate([np.empty(0), *(each.magnitudes(self._span) for each in self._watched)])

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
        scale = np.maximum(self._scale, self._magnitudes())
        allowed = (self._control.tolerance * scale + self._control.absolute) * (step / self._span)
        ratio = np.divide(error, allowed, out=np.where(error > 0.0, np.inf, 0.0), where=allowed > 0.0)
        worst = int(np.argmax(ratio))
        return float(ratio[worst]), self._names[worst]


def _watched_by_default(system: System, ports: Sequence[OutputPort], couplings: Couplings) -> list[Watched]:
    """Of all slaves whose inputs have an error: outputs that are passed on, with their derivatives; without these, or
    where nothing is passed on, all continuous outputs."""
    erring = {target for (_, target), coupling in couplings.items() if _counts(coupling)}
    watched = []
    for i in sorted(erring):
        port = ports[i]
        used = {each.output for each in system.connections if each.source == i}
        if used and port.recorded >= WATCHED_ROWS:
            watched.append(Watched(port, np.searchsorted(port.indices, sorted(used)).tolist(), WATCHED_ROWS))
            continue
        continuous = [k for k, index in enumerate(port.indices) if not port.slave.variables[index].discrete]
        watched.append(Watched(port, continuous, 1))
    return watched


def _find(ports: Sequence[OutputPort], name: str) -> Watched:
    """The named output, with its first derivative if it has one.

    Raises:
        InputError: there is no such output.
    """
    known = {}
    for port in ports:
        for column, index in enumerate(port.indices):
            known[f"{port.slave.name}.{port.slave.variables[index].name}"] = port, column
    if name not in known:
        hint = get_close_matches(name, known, n=1, cutoff=0.0)
        remedy = f"; did you mean {hint[0]!r}?" if hint else ", nor any other"
        raise InputError(f"step control can't watch {name!r}: there is no such output{remedy}")
    port, column = known[name]
    return Watched(port, [column], min(port.recorded, WATCHED_ROWS))


def _counts(coupling: Coupling) -> bool:
    """Whether the coupling has an error that depends on the step."""
    return coupling.transport in (Transport.EXTRAPOLATED, Transport.INTERPOLATED, Transport.AVERAGED)


def _degree(coupling: Coupling) -> int:
    """Degree of the polynomials."""
    if coupling.transport is Transport.AVERAGED:
        return 1
    return coupling.order if coupling.ends is None else 2 * coupling.ends + 1
