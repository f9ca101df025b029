"""The coupling error: local over one step, and accumulated over the run."""

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
"""Perturbation of an input, relative and absolute, that shows which output derivatives depend on it directly."""

PEERS = 1.0 / 3.0
"""Least magnitude of a signal relative to the largest of the same slave and unit.

Without it a velocity component that has hardly begun to change, say, would have too small a tolerance."""

TINY = float(np.finfo(np.float64).tiny)
"""Smallest denominator, so that 0 / 0 becomes 0."""


@dataclass(frozen=True)
class MonitoredSignals:
    """Signals of an output port whose error is monitored.

    Attributes:
        port: the output port.
        rows, columns: (n,) indices into the port's signals: row 0 for values, row 1 for first derivatives.
    """

    port: OutputPort
    rows: Indices
    columns: Indices

    @property
    def names(self) -> list[str]:
        """Names (n): ``slave.output``, or ``der(slave.output,1)`` for a first derivative."""
        slave = self.port.slave
        names = [f"{slave.name}.{slave.variables[self.port.indices[column]].name}" for column in self.columns]
        return [f"der({name},1)" if row else name for name, row in zip(names, self.rows, strict=True)]

    @property
    def kinds(self) -> list[tuple[str, str]]:
        """Pairs (n) of slave and unit; in place of an unknown unit the name of the output."""
        variables = [self.port.slave.variables[self.port.indices[column]] for column in self.columns]
        units = [each.unit or each.name for each in variables]
        return [(self.port.slave.name, unit + "/s" * row) for unit, row in zip(units, self.rows.tolist(), strict=True)]

    def with_rates(self, inputs: InputPort) -> MonitoredSignals:
        """These signals and the first derivatives that don't depend directly on an input with a coupling error."""
        if self.port.recorded < 2:
            return self
        rates = self.columns[~_entered_rates(inputs, self.port)[self.columns]]
        rows = np.concatenate([self.rows, np.ones(rates.size, np.intp)])
        return MonitoredSignals(self.port, rows, np.concatenate([self.columns, rates]))


class CouplingError:
    """Estimates the coupling error of the monitored signals, relative to their tolerance.

    Attributes:
        order: power of the step to which the error per unit step is proportional.
        following: ports of monitored signals that may depend directly on inputs without a coupling error (from slaves
            that predict their outputs or sample); they are read again after these inputs have been set.
    """

    def __init__(
        self, system: System, ports: Sequence[OutputPort], couplings: Couplings, control: StepDoubling, span: float
    ) -> None:
        self._control = control
        self._span = span
        # signals to monitor, and the order of their error
        if control.signals is None:
            self._monitored = _monitored_by_default(system, ports, couplings)
        else:
            self._monitored = _find(ports, control.signals)
        self._slaves = [system.slaves.index(each.port.slave) for each in self._monitored]
        self.order = 1 + min(map(_degree, filter(_counts, couplings.values())), default=0)
        self.following: list[OutputPort] = []

    def start(self, inputs: Sequence[InputPort]) -> None:
        """Monitor first derivatives too, except those that depend directly on an input with a coupling error.

        Velocities accumulate errors; accelerations follow from the inputs. The slaves must have been initialised and
        their inputs set. Monitored outputs named by the user get no derivatives.

        Args:
            inputs: input ports, in the order of `System.slaves`.
        """
        # ports that are read again after a step, and first derivatives
        pairs = list(zip(self._monitored, (inputs[slave] for slave in self._slaves), strict=True))
        self.following = [
            each.port for each, port in pairs if any(not _errs(group.source.slave) for group in port.groups)
        ]
        if self._control.signals is None:
            self._monitored = [each.with_rates(port) for each, port in pairs]
        # flat indices of the signals in their ports
        self._places = [
            (each.port.signals.reshape(-1), each.rows * each.port.indices.size + each.columns)
            for each in self._monitored
        ]
        self._names = [name for each in self._monitored for name in each.names]
        # kinds: signals of one slave with the same unit share a magnitude
        kinds = [kind for each in self._monitored for kind in each.kinds]
        known = list(dict.fromkeys(kinds))
        self._kind = np.array([known.index(kind) for kind in kinds], np.intp)
        rates = [
            (known.index((slave, unit + "/s")), i)
            for i, (slave, unit) in enumerate(known)
            if (slave, unit + "/s") in known
        ]
        # for each kind of rates: its index, and that of the kind it is the derivative of
        self._rates, self._changing = np.array(rates, np.intp).reshape(-1, 2).T
        self._of_kind, self._scale = np.zeros(len(known)), np.zeros(len(kinds))

    def signals(self) -> RealArray:
        """(n,) the current monitored signals."""
        found = [signals.take(places) for signals, places in self._places]
        return found[0] if len(found) == 1 else np.concatenate([np.empty(0), *found])

    def learn(self, signals: RealArray) -> None:
        """Update the magnitudes with the signals (n,).

        A signal's magnitude is its largest absolute value so far, but no less than `PEERS` times the largest of its
        kind (same slave and unit). A rate's magnitude is also at least the largest of the signals that it is the rate
        of, divided by the length of the run.
        """
        sizes, largest = abs(signals), self._of_kind
        np.maximum.at(largest, self._kind, sizes)
        np.maximum.at(largest, self._rates, largest[self._changing] / (PEERS * self._span))
        self._scale = np.maximum(np.maximum(self._scale, sizes), PEERS * largest[self._kind])

    def compare(self, short: RealArray, long: RealArray) -> tuple[RealArray, RealArray]:
        """(n,) error relative to the tolerance, and (n,) fraction by which the magnitude has grown since `learn`.

        Args:
            short: (n,) signals of the half steps.
            long: (n,) signals of the whole step.
        """
        scale = np.maximum(self._scale, abs(short))
        return self._over(abs(short - long), scale), 1.0 - self._scale / np.maximum(scale, TINY)

    def learned(self, short: RealArray, long: RealArray) -> RealArray:
        """(n,) error relative to the tolerance, as in `compare`, with the magnitudes of the last `learn`."""
        return self._over(abs(short - long), self._scale)

    def _over(self, differences: RealArray, scale: RealArray) -> RealArray:
        """(n,) Richardson's error estimate relative to the tolerance, for signals of magnitude ``scale``."""
        allowed = (2.0**self.order - 1.0) * (self._control.tolerance * scale + self._control.absolute)
        return differences / np.maximum(allowed, TINY)

    def name(self, signal: int) -> str:
        """Name of the monitored signal with this index."""
        return self._names[signal]


def _monitored_by_default(system: System, ports: Sequence[OutputPort], couplings: Couplings) -> list[MonitoredSignals]:
    """Monitored outputs of all slaves whose inputs have a coupling error.

    These are the continuous outputs that are connected; all continuous outputs if none is connected or the slave gives
    no derivatives. Outputs that depend directly on an input with a coupling error (a spring's force, say) follow from
    the others and are left out, unless no slave has others.
    """
    monitored: list[MonitoredSignals] = []
    following: list[MonitoredSignals] = []
    for i in sorted({target for (_, target), coupling in couplings.items() if _counts(coupling)}):
        port, variables = ports[i], ports[i].slave.variables
        # connected outputs
        used = {each.output for each in system.connections if each.source == i and port.recorded > 1}
        # inputs with an error, and outputs that depend directly on them
        erring = {
            variables[each.input].name
            for each in system.connections
            if each.target == i and _errs(system.slaves[each.source])
        }
        entered = {name for name, inputs in feedthrough(port.slave).items() if erring & set(inputs)}
        # continuous outputs; preferably those without direct feedthrough from inputs with an error
        columns = [
            k
            for k, index in enumerate(port.indices)
            if index in (used or port.indices) and not variables[index].discrete
        ]
        states = [k for k in columns if variables[port.indices[k]].name not in entered]
        (monitored if states else following).append(_values(port, states or columns))
    return monitored or following


def _errs(source: Slave) -> bool:
    """Whether the slave's outputs can have a coupling error at communication points, as those of stepped slaves do."""
    return not isinstance(source, PredictsOutputs | Sampled)


def _entered_rates(inputs: InputPort, outputs: OutputPort) -> NDArray[np.bool_]:
    """(n,) whether the first derivative of each output depends directly on an input with a coupling error."""
    # perturb all inputs with an error and compare the derivatives
    before, fed = outputs.signals.copy(), inputs.fed.copy()
    with StateKeeper([inputs.slave]) as state:
        for group in inputs.groups:
            if _errs(group.source.slave):
                inputs.fed[0, group.slots] += NUDGE * (1.0 + abs(fed[0, group.slots]))
        inputs.send()
        outputs.transfer()
        entered: NDArray[np.bool_] = outputs.signals[1] != before[1]
        state.restore()
    # restore the buffers; the slave has been rolled back
    inputs.fed[:], outputs.signals[:] = fed, before
    return entered


def _find(ports: Sequence[OutputPort], names: Sequence[str]) -> list[MonitoredSignals]:
    """The monitored signals for the outputs named ``slave.output``.

    Raises:
        InputError: there is no such output.
    """
    known = {
        f"{port.slave.name}.{port.slave.variables[index].name}": (port, column)
        for port in ports
        for column, index in enumerate(port.indices)
    }
    # columns of the named outputs, by port
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
    """The values of these columns of a port, without derivatives."""
    return MonitoredSignals(port, np.zeros(len(columns), np.intp), np.array(columns, np.intp))


def _counts(coupling: Coupling) -> bool:
    """Whether the coupling error depends on the communication step."""
    return coupling.transport in (Transport.EXTRAPOLATED, Transport.INTERPOLATED, Transport.AVERAGED)


def _degree(coupling: Coupling) -> int:
    """Degree of the polynomial that the coupling represents exactly; 1 for the mean of both ends."""
    if coupling.transport is Transport.AVERAGED:
        return 1
    return coupling.order if coupling.ends is None else 2 * coupling.ends + 1
