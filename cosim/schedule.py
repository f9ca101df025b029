"""The order of a run: who is initialised, set, read, sampled and stepped when."""

from __future__ import annotations

from dataclasses import dataclass

from flexfmu.cosim.grid import TimeGrid, is_sample_instant
from flexfmu.cosim.links import loop_order, stale_after_step, wire
from flexfmu.cosim.ports import InputPort, OutputPort
from flexfmu.cosim.slave import KnowsItsFuture, Sampled, Slave
from flexfmu.cosim.system import System


@dataclass(frozen=True)
class Visit:
    """One slave's turn in an exchange.

    Attributes:
        slave, inputs, outputs: the slave with its ports.
        stale: whether its outputs must be read anew even where nothing jumps.
        due: for a sampled slave whether it samples at each communication point; empty for others, and on all but its
            last visit.
    """

    slave: Slave
    inputs: InputPort
    outputs: OutputPort
    stale: bool
    due: tuple[bool, ...] = ()


class Schedule:
    """Exchanges and steps of a system on a time grid.

    Attributes:
        outputs: output ports, in the order of `System.slaves`; their signals are those of the current instant.
        active: name of the slave that is, or was last, at work.
    """

    def __init__(self, system: System, grid: TimeGrid) -> None:
        inputs, self.outputs = wire(system)
        self.active = ""
        self._grid = grid
        self._first_visits = [
            (system.slaves[i], inputs[i], self.outputs[i]) for i in dict.fromkeys(system.exchange_order)
        ]
        self._futures = [(each, port) for each, _, port in self._first_visits if isinstance(each, KnowsItsFuture)]
        self._visits = _visits(system, inputs, self.outputs, grid)
        stepped = [i for i in system.step_order if not isinstance(system.slaves[i], Sampled)]
        self._steps = [(system.slaves[i], inputs[i], bool(inputs[i].interpolating), self.outputs[i]) for i in stepped]
        self._rounds = loop_order(system)
        self._interpolating = [inputs[i] for i in stepped if inputs[i].interpolating]

    def initialize(self, tolerance: float | None) -> None:
        """Initialise the slaves, each with the outputs of those before it, and read them."""
        start, stop = float(self._grid.times[0]), float(self._grid.times[-1])
        for slave, inputs, outputs in self._first_visits:
            self.active = slave.name
            if isinstance(slave, KnowsItsFuture):
                slave.prepare(self._grid.times)
            inputs.preset()
            slave.initialize(start, stop, tolerance)
            inputs.bind()
            outputs.bind()
            outputs.read(start)

    def exchange(self, point: int, time: float, jump: bool) -> None:
        """Pass on the outputs at a communication point; afterwards all is ready for the step that begins there.

        Args:
            point: index of the communication point.
            time: its time [s].
            jump: whether signals may jump, as they may at the start: all outputs are read anew.
        """
        for future, port in self._futures:
            self.active = future.name
            future.announce(time)
            port.read_announced()
        for visit in self._visits:
            self.active = visit.slave.name
            visit.inputs.exchange()
            if visit.due and visit.due[point] and isinstance(visit.slave, Sampled):
                visit.slave.sample(time)
            if jump or visit.stale:
                visit.outputs.read(time)
        if jump:
            self._settle(time)

    def _settle(self, time: float) -> None:
        """Let the derivatives go round closed loops until they belong to the same instant.

        The k-th derivative of an output depends on derivatives of the inputs up to the k-th, so that one more is right
        after each round.
        """
        for _ in range(self._rounds):
            for visit in self._visits:
                self.active = visit.slave.name
                visit.inputs.exchange()
                visit.outputs.read(time)

    def advance(self, begin: float, end: float) -> None:
        """Step all slaves from one communication point to the next and read them."""
        step = end - begin
        for inputs in self._interpolating:
            inputs.remember()
        for slave, inputs, interpolating, outputs in self._steps:
            self.active = slave.name
            if interpolating:
                inputs.interpolate(step)
            slave.step(begin, step)
            outputs.read(end)


def _visits(system: System, inputs: list[InputPort], outputs: list[OutputPort], grid: TimeGrid) -> list[Visit]:
    """The turns of all slaves that have connected inputs or sample instants."""
    stale = stale_after_step(system)
    last = {slave: rank for rank, slave in enumerate(system.exchange_order)}
    visits = []
    for rank, i in enumerate(system.exchange_order):
        slave = system.slaves[i]
        due: tuple[bool, ...] = ()
        if isinstance(slave, Sampled) and rank == last[i]:
            due = tuple(is_sample_instant(grid, slave.sample_time).tolist())
        if inputs[i].links or due:
            visits.append(Visit(slave, inputs[i], outputs[i], i in stale, due))
    return visits
