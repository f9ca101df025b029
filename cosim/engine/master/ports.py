"""Ports: for each slave the buffers of its outputs and inputs, the calls that transfer them, and the groups of signals
that connect them.

Over a communication step an input follows a polynomial. It extrapolates the value and derivatives of its source from
the beginning of the step (Taylor polynomial) or, if the source is already at the end of the step, interpolates them
between both ends (Hermite polynomial).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from flexfmu.cosim.engine.binding import bind, nothing
from flexfmu.cosim.engine.errors import InputError, NotFiniteError, SlaveError
from flexfmu.cosim.engine.hermite import hermite_derivatives
from flexfmu.cosim.engine.master.couplings import Coupling, Couplings, Transport
from flexfmu.cosim.engine.master.system import IDENTITY, Connection, LinearMap, System, TableMap
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.engine.slave import Indices, PredictsOutputs, RealArray, Slave, output_order

TimedCall = Callable[[int, float, float], object]
"""A call with the index of the communication point, begin and end [s]; at an instant begin = end."""


class OutputPort:
    """Outputs of a slave at the current instant: those that are connected or recorded.

    Args:
        slave: the slave.
        coupling_order: highest derivative that a connected input uses.
        fed: indices of the connected outputs.
        selection: which outputs are recorded, with how many derivatives.

    Attributes:
        slave: the slave.
        indices: (n,) the outputs, as indices in `Slave.variables`.
        signals: (orders + 1, n) values in row 0, k-th derivatives in row k.
        recorded: number of rows of ``signals`` that are recorded.
        transfer: call that fills ``signals`` with the outputs after a step.
        read_announced: call that fills ``signals`` with the announced polynomials at the beginning of a step.
    """

    def __init__(
        self, slave: Slave, coupling_order: int, fed: Collection[int] = (), selection: Selection = EVERYTHING
    ) -> None:
        # which outputs, and how many derivatives of them
        outputs = [(i, each.name) for i, each in enumerate(slave.variables) if each.causality == "output"]
        wanted = [i for i, name in outputs if i in fed or selection.keeps(f"{slave.name}.{name}")]
        self.slave = slave
        self.indices: Indices = np.array(wanted, np.intp)
        self.recorded = 1 + min(output_order(slave), selection.order)
        self.signals = np.zeros((max(self.recorded, 1 + coupling_order), self.indices.size))
        # buffer for the check of `reading`, and the calls that fill the signals
        self._finite = np.ones(self.signals.shape, dtype=np.bool_)
        self.transfer = self.read_announced = nothing
        if self.indices.size:
            # a slave that predicts its outputs has more derivatives at the beginning of a step than at its end
            rows = self.recorded if isinstance(slave, PredictsOutputs) else self.signals.shape[0]
            self.transfer = bind(slave, "get", self.indices, self.signals[:rows])
            self.read_announced = bind(slave, "get", self.indices, self.signals)

    def reset(self) -> None:
        """Set the signals of an earlier run to zero."""
        self.signals.fill(0.0)

    def read(self, time: float) -> None:
        """Read the slave's outputs at ``time`` [s] into ``signals``.

        Raises:
            NotFiniteError: an output or one of its derivatives is infinite or not a number.
        """
        self.reading()(0, time, time)

    def reading(self) -> TimedCall:
        """A call that reads the slave's outputs at its ``end``, as `read` does."""
        transfer, signals, finite, isfinite = self.transfer, self.signals, self._finite, np.isfinite

        def read(point: int, begin: float, end: float) -> None:
            transfer()
            isfinite(signals, finite)
            # eight times faster than all()
            if b"\0" in finite.tobytes():
                raise self.not_finite(end)

        return read

    def not_finite(self, time: float) -> NotFiniteError:
        """The error for the first output or derivative that isn't finite."""
        order, column = np.argwhere(~np.isfinite(self.signals))[0]
        name = self.slave.variables[self.indices[column]].name
        what = f"der({name},{order})" if order else name
        return NotFiniteError(self.slave.name, f"{what} became {self.signals[order, column]}", time)


@dataclass(frozen=True)
class Transformation:
    """Maps of a group of signals.

    Attributes:
        factor, offset: (n,) y = factor x + offset.
        tables: (column, table) for each signal that is mapped by a table instead.
    """

    factor: RealArray
    offset: RealArray
    tables: tuple[tuple[int, TableMap], ...] = ()

    def apply(self, fed: RealArray) -> None:
        """Map values and derivatives (orders + 1, n) in place; derivatives of a table's values are zero.

        Raises:
            InputError: a table has no entry for a value.
        """
        fed *= self.factor
        fed[0] += self.offset
        for column, table in self.tables:
            fed[0, column] = table(fed[0, column])
            fed[1:, column] = 0.0


@dataclass(frozen=True)
class SignalGroup:
    """Outputs of one slave that feed contiguous inputs of another.

    Attributes:
        source: output port of the source.
        columns: (n,) their columns in the source's signals.
        slots: the columns of the inputs in `InputPort.fed`.
        coupling: polynomial of the inputs over a step.
        transformation: maps from outputs to inputs; None for the identity.
        jumping: which of the inputs are discrete or mapped by a table: they keep their value instead of a mean of both
            ends.
    """

    source: OutputPort
    columns: Indices
    slots: slice
    coupling: Coupling
    transformation: Transformation | None = None
    jumping: Indices = field(default_factory=lambda: np.empty(0, np.intp))

    @property
    def interpolates(self) -> bool:
        """Whether the inputs depend on the signals at the end of a step."""
        return self.coupling.ends is not None

    @property
    def degree(self) -> int:
        """Highest degree of the polynomials."""
        if self.coupling.ends is None or self.coupling.transport is Transport.AVERAGED:
            return self.coupling.order
        return max(self.coupling.order, 2 * self.coupling.ends + 1)

    def extrapolation(self, fed: RealArray) -> Callable[[], object]:
        """A call that writes values and derivatives at the current instant into ``fed`` (orders + 1, inputs)."""
        rows = self.coupling.order + 1
        signals = self.source.signals[:rows]
        # a single copy if the group fills the whole buffer
        whole = partial(signals.take, self.columns, 1, fed, "clip") if fed.shape == (rows, self.columns.size) else None
        if whole is not None and self.transformation is None:
            return whole

        def extrapolate() -> None:
            if whole is not None:
                whole()
            else:
                fed[:rows, self.slots] = signals[:, self.columns]
                fed[rows:, self.slots] = 0.0
            self._transform(fed)

        return extrapolate

    def ended(self) -> RealArray:
        """(ends + 1, n) values and derivatives at the current instant that the interpolation matches."""
        return self.source.signals[: (self.coupling.ends or 0) + 1].take(self.columns, 1)

    def interpolate(self, begin: RealArray, step: float, fed: RealArray) -> None:
        """Write the coefficients of the interpolating polynomial into ``fed``.

        Args:
            begin: (ends + 1, n) values and derivatives at the beginning of the step; the current ones are at its end.
            step: its length [s].
            fed: (orders + 1, inputs) values and derivatives at the beginning of the step.
        """
        fed[:, self.slots] = 0.0
        if self.coupling.transport is Transport.AVERAGED:
            # the mean of both ends; a discrete input keeps its value from the beginning
            mean = 0.5 * (begin[0] + self.ended()[0])
            mean[self.jumping] = begin[0, self.jumping]
            fed[0, self.slots] = mean
        else:
            fed[: 2 * len(begin), self.slots] = hermite_derivatives(begin, self.ended(), step)
        self._transform(fed)

    def _transform(self, fed: RealArray) -> None:
        """Map the signals of the group in ``fed``, in place.

        Raises:
            SlaveError: a table has no entry for an output of the source.
        """
        if self.transformation is not None:
            try:
                self.transformation.apply(fed[:, self.slots])
            except InputError as error:
                raise SlaveError(self.source.slave.name, str(error)) from error


class InputPort:
    """The connected inputs of a slave.

    Attributes:
        slave: the slave.
        groups: the inputs by source.
        fed: (orders + 1, n) values in row 0, k-th derivatives in row k.
        interpolating: the groups that are interpolated.
        send: a call that sets the slave's inputs to ``fed``.
    """

    def __init__(self, slave: Slave, indices: Indices, groups: Sequence[SignalGroup]) -> None:
        self.slave = slave
        self.groups = tuple(groups)
        # one buffer for all inputs, and calls that fill and send it
        self.fed = np.zeros((1 + max((group.degree for group in groups), default=0), indices.size))
        self.interpolating = tuple(group for group in groups if group.interpolates)
        self._begins: list[RealArray] = []
        self._indices = indices
        self._extrapolations = [group.extrapolation(self.fed) for group in groups]
        self.send = bind(slave, "set", indices, self.fed) if groups else nothing

    def reset(self) -> None:
        """Set the signals of an earlier run to zero."""
        self.fed.fill(0.0)

    def preset(self, ready: Collection[OutputPort]) -> None:
        """Set inputs with sources in ``ready`` before the slave is initialised; others keep their start values."""
        for group, extrapolate in zip(self.groups, self._extrapolations, strict=True):
            if group.source in ready:
                extrapolate()
                self.slave.set(self._indices[group.slots], self.fed[0, group.slots])

    def feeding(self) -> TimedCall:
        """A call that sets the inputs to the connected outputs at the current instant; it ignores its arguments."""
        calls = (*self._extrapolations, self.send)

        def feed(point: int, begin: float, end: float) -> None:
            for call in calls:
                call()

        return feed

    def remember(self) -> None:
        """Keep the interpolated signals at the beginning of a step."""
        self._begins = [group.ended() for group in self.interpolating]

    def interpolate(self, step: float) -> None:
        """Set the interpolated inputs, whose sources have already been stepped, for a step of this length [s]."""
        for group, begin in zip(self.interpolating, self._begins, strict=True):
            group.interpolate(begin, step, self.fed)
        self.send()


def wire(
    system: System, coupled: Couplings, selection: Selection = EVERYTHING
) -> tuple[list[InputPort], list[OutputPort]]:
    """Input ports and output ports of all slaves, in the order of `System.slaves`."""
    outputs = []
    for i, slave in enumerate(system.slaves):
        # as many derivatives as its targets use
        orders = [max(each.order, each.ends or 0) for (source, _), each in coupled.items() if source == i]
        fed = {each.output for each in system.connections if each.source == i}
        outputs.append(OutputPort(slave, max(orders, default=0), fed, selection))
    return [_input_port(system, i, outputs, coupled) for i in range(len(system.slaves))], outputs


def _input_port(system: System, target: int, outputs: list[OutputPort], coupled: Couplings) -> InputPort:
    """The port of one slave, its inputs grouped by source."""
    incoming = sorted((each for each in system.connections if each.target == target), key=lambda each: each.source)
    groups, count = [], 0
    for source in dict.fromkeys(each.source for each in incoming):
        # inputs from one source are contiguous in the buffer
        group = [each for each in incoming if each.source == source]
        slots = slice(count, count + len(group))
        place, variables = columns(outputs[source], group), system.slaves[target].variables
        jumping = np.flatnonzero(
            [variables[each.input].discrete or isinstance(each.transformation, TableMap) for each in group]
        )
        groups.append(
            SignalGroup(outputs[source], place, slots, coupled[source, target], transformation(group), jumping)
        )
        count += len(group)
    return InputPort(system.slaves[target], np.array([each.input for each in incoming], np.intp), groups)


def columns(port: OutputPort, group: Sequence[Connection]) -> Indices:
    """(n,) columns of the port's signals that the connections start from."""
    return np.searchsorted(port.indices, [each.output for each in group])


def transformation(group: Sequence[Connection]) -> Transformation | None:
    """The maps of the connections; None if all of them are the identity."""
    maps = [each.transformation for each in group]
    if all(each == IDENTITY for each in maps):
        return None
    tables = tuple((column, each) for column, each in enumerate(maps) if isinstance(each, TableMap))
    lines = [each if isinstance(each, LinearMap) else IDENTITY for each in maps]
    return Transformation(np.array([each.factor for each in lines]), np.array([each.offset for each in lines]), tables)
