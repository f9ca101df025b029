"""The error of the coupling: over one step, and what has accumulated of it since the start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.couplings import Coupling, Couplings, Transport
from flexfmu.cosim.engine.master.loops import StateKeeper
from flexfmu.cosim.engine.master.ports import InputPort, OutputPort
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.slave import Indices, PredictsOutputs, RealArray, Sampled, Slave, feedthrough

NUDGE = 1e-6
"""Change of an input, relative and absolute, that shows which derivatives it enters at once."""

PEERS = 1.0 / 3.0
"""A signal's magnitude is at least this part of that of others of its kind: the second component of a velocity, say, that
has hardly begun to change."""

TINY = float(np.finfo(np.float64).tiny)
"""Keeps quotients of zeros finite."""


@dataclass(frozen=True)
class MonitoredSignals:
    """Signals of a port whose error counts.

    Attributes:
        port: the port.
        rows, columns: (n,) which of its signals: values in row 0, first derivatives in row 1.
    """

    port: OutputPort
    rows: Indices
    columns: Indices

    @property
    def names(self) -> list[str]:
        """Their names."""
        slave = self.port.slave
        names = [f"{slave.name}.{slave.variables[self.port.indices[column]].name}" for column in self.columns]
        return [f"der({name},1)" if row else name for name, row in zip(names, self.rows, strict=True)]

    @property
    def kinds(self) -> list[tuple[str, str]]:
        """For each the slave and the unit, or the output's own name in place of an unknown unit."""
        variables = [self.port.slave.variables[self.port.indices[column]] for column in self.columns]
        units = [each.unit or each.name for each in variables]
        return [(self.port.slave.name, unit + "/s" * row) for unit, row in zip(units, self.rows.tolist(), strict=True)]

    def with_rates(self, inputs: InputPort) -> MonitoredSignals:
        """With the first derivatives of all values that don't change at once with an input that errs."""
        if self.port.recorded < 2:
            return self
        rates = self.columns[~_entered_rates(inputs, self.port)[self.columns]]
        rows = np.concatenate([self.rows, np.ones(rates.size, np.intp)])
        return MonitoredSignals(self.port, rows, np.concatenate([self.columns, rates]))


class CouplingError:
    """Compares signals with each other and with what they may differ.

    Attributes:
        order: power of the step that the error per unit step goes with.
        following: output ports of signals that what is known in advance may enter at once: to be read when it is passed on.
    """

    def __init__(
        self, system: System, ports: Sequence[OutputPort], couplings: Couplings, control: StepDoubling, span: float
    ) -> None:
        self._control = control
        self._span = span
        # signals to watch, and the order that their error goes with
        if control.signals is None:
            self._monitored = _monitored_by_default(system, ports, couplings)
        else:
            self._monitored = _find(ports, control.signals)
        self._slaves = [system.slaves.index(each.port.slave) for each in self._monitored]
        self.order = 1 + min(map(_degree, filter(_counts, couplings.values())), default=0)
        self.following: list[OutputPort] = []

    def start(self, inputs: Sequence[InputPort]) -> None:
        """Watch first derivatives too, unless an input that errs enters them at once: the rates of positions accumulate
        errors, accelerations don't. The slaves must have been initialised and fed.

        Args:
            inputs: input ports, in the order of `System.slaves`.
        """
        # signals that are read once more after a step, and first derivatives
        pairs = list(zip(self._monitored, (inputs[slave] for slave in self._slaves), strict=True))
        self.following = [
            each.port for each, port in pairs if any(not _errs(group.source.slave) for group in port.groups)
        ]
        if self._control.signals is None:
            self._monitored = [each.with_rates(port) for each, port in pairs]
        # where the signals are in their ports
        self._places = [
            (each.port.signals.reshape(-1), each.rows * each.port.indices.size + each.columns)
            for each in self._monitored
        ]
        self._names = [name for each in self._monitored for name in each.names]
        # magnitudes are learned by kind: signals of one slave with one unit
        kinds = [kind for each in self._monitored for kind in each.kinds]
        known = list(dict.fromkeys(kinds))
        self._kind = np.array([known.index(kind) for kind in kinds], np.intp)
        rates = [
            (known.index((slave, unit + "/s")), i)
            for i, (slave, unit) in enumerate(known)
            if (slave, unit + "/s") in known
        ]
        # index of a rate's kind, and of the kind that it is the rate of
        self._rates, self._changing = np.array(rates, np.intp).reshape(-1, 2).T
        self._of_kind, self._scale = np.zeros(len(known)), np.zeros(len(kinds))

    def signals(self) -> RealArray:
        """(n,) the current signals."""
        found = [signals.take(places) for signals, places in self._places]
        return found[0] if len(found) == 1 else np.concatenate([np.empty(0), *found])

    def learn(self, signals: RealArray) -> None:
        """Take signals (n,) into account for the magnitudes: each its own largest one so far, no less than a third of that
        of its slave's others with the same unit, nor, for a rate, than what changes its signal once in a run."""
        sizes, largest = abs(signals), self._of_kind
        np.maximum.at(largest, self._kind, sizes)
        np.maximum.at(largest, self._rates, largest[self._changing] / (PEERS * self._span))
        self._scale = np.maximum(np.maximum(self._scale, sizes), PEERS * largest[self._kind])

    def compare(self, short: RealArray, long: RealArray) -> tuple[RealArray, RealArray]:
        """(n,) the error of signals over the tolerance, and by which part their magnitudes have grown since `learn`.

        Args:
            short: (n,) the signals.
            long: (n,) the same from steps twice as long.
        """
        scale = np.maximum(self._scale, abs(short))
        return self._over(abs(short - long), scale), 1.0 - self._scale / np.maximum(scale, TINY)

    def learned(self, short: RealArray, long: RealArray) -> RealArray:
        """(n,) the first of both, of signals that `learn` has had last."""
        return self._over(abs(short - long), self._scale)

    def _over(self, differences: RealArray, scale: RealArray) -> RealArray:
        """(n,) differences over what is allowed for signals of these magnitudes."""
        allowed = (2.0**self.order - 1.0) * (self._control.tolerance * scale + self._control.absolute)
        return differences / np.maximum(allowed, TINY)

    def name(self, signal: int) -> str:
        """Name of a signal."""
        return self._names[signal]


def _monitored_by_default(system: System, ports: Sequence[OutputPort], couplings: Couplings) -> list[MonitoredSignals]:
    """Of all slaves whose inputs have an error: outputs that are passed on; all continuous ones where none is, or where
    they give no rates. Those that an erring input enters at once, as it does a spring's force, follow the others; they
    count if there are no others."""
    monitored: list[MonitoredSignals] = []
    following: list[MonitoredSignals] = []
    for i in sorted({target for (_, target), coupling in couplings.items() if _counts(coupling)}):
        port, variables = ports[i], ports[i].slave.variables
        # outputs that are passed on
        used = {each.output for each in system.connections if each.source == i and port.recorded > 1}
        # inputs with an error, and outputs that they enter at once
        erring = {
            variables[each.input].name
            for each in system.connections
            if each.target == i and _errs(system.slaves[each.source])
        }
        entered = {name for name, inputs in feedthrough(port.slave).items() if erring & set(inputs)}
        # continuous outputs; those that no erring input enters at once go first
        columns = [
            k
            for k, index in enumerate(port.indices)
            if index in (used or port.indices) and not variables[index].discrete
        ]
        states = [k for k in columns if variables[port.indices[k]].name not in entered]
        (monitored if states else following).append(_values(port, states or columns))
    return monitored or following


def _errs(source: Slave) -> bool:
    """Whether the slave's outputs carry an error at communication points too, as those of a slave that is stepped do."""
    return not isinstance(source, PredictsOutputs | Sampled)


def _entered_rates(inputs: InputPort, outputs: OutputPort) -> NDArray[np.bool_]:
    """(n,) which first derivatives of a slave's outputs change at once with an input that errs."""
    # what the derivatives become when all inputs that err are changed a little
    before, fed = outputs.signals.copy(), inputs.fed.copy()
    with StateKeeper([inputs.slave]) as state:
        for group in inputs.groups:
            if _errs(group.source.slave):
                inputs.fed[0, group.slots] += NUDGE * (1.0 + abs(fed[0, group.slots]))
        inputs.send()
        outputs.transfer()
        entered: NDArray[np.bool_] = outputs.signals[1] != before[1]
        state.restore()
    # buffers as before; the slave is already back
    inputs.fed[:], outputs.signals[:] = fed, before
    return entered


def _find(ports: Sequence[OutputPort], names: Sequence[str]) -> list[MonitoredSignals]:
    """The named outputs.

    Raises:
        InputError: there is no such output.
    """
    known = {
        f"{port.slave.name}.{port.slave.variables[index].name}": (port, column)
        for port in ports
        for column, index in enumerate(port.indices)
    }
    # columns of each port that are asked for
    columns: dict[OutputPort, list[int]] = {}
    for name in names:
        if name not in known:
            hint = get_close_matches(name, known, n=1, cutoff=0.0)
            remedy = f"; did you mean {hint[0]!r}?" if hint else ", nor any other"
            raise InputError(f"step control can't watch {name!r}: there is no such output{remedy}")
        port, column = known[name]
        columns.setdefault(port, []).append(column)
    return [_values(port, each) for port, each in columns.items()]


def _values(port: OutputPort, columns: Sequence[int]) -> MonitoredSignals:
    """Values of a port's signals."""
    return MonitoredSignals(port, np.zeros(len(columns), np.intp), np.array(columns, np.intp))


def _counts(coupling: Coupling) -> bool:
    """Whether the coupling has an error that depends on the step."""
    return coupling.transport in (Transport.EXTRAPOLATED, Transport.INTERPOLATED, Transport.AVERAGED)


def _degree(coupling: Coupling) -> int:
    """Degree of the polynomials."""
    if coupling.transport is Transport.AVERAGED:
        return 1
    return coupling.order if coupling.ends is None else 2 * coupling.ends + 1
