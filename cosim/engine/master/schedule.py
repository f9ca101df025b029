"""The order of calls in a run: which slave is initialised, set, read, sampled and stepped when.

A run alternates between steps and exchanges. Over a step (`Schedule.advance`) every slave is advanced to the next
communication point. There (`Schedule.exchange`) slaves announce the coming step, then the exchange steps pass outputs on to
inputs, in the order of direct feedthrough; algebraic loops are solved in their place. `flexfmu.cosim.engine.master.program`
lists the same calls for the loop in C: what changes here changes there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from ctypes import c_int, sizeof
from dataclasses import dataclass
from mmap import mmap

import numpy as np

from flexfmu.cosim.engine.master.algorithms import Algorithm
from flexfmu.cosim.engine.master.couplings import couplings, loop_order, stale_after_step
from flexfmu.cosim.engine.master.exchange import ExchangeStep, InstantLoop, plan_exchange_steps
from flexfmu.cosim.engine.master.grid import TimeGrid
from flexfmu.cosim.engine.master.ports import OutputPort, wire
from flexfmu.cosim.engine.master.repeated_steps import LoopSignals, StateKeeper, needs_rollback
from flexfmu.cosim.engine.master.stepping import Stepping
from flexfmu.cosim.engine.master.system import AlgebraicLoop, System
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.engine.slave import Indices, PredictsOutputs, RealArray, Sampled

OFF_GRID = -1
"""Stands for the index of a communication point that step control has put between those of the grid."""


class Schedule:
    """Exchanges and steps of a system on a time grid, for one run after the other.

    Args:
        system: slaves and connections.
        grid: the points of the runs.
        algorithm: how slaves are coupled over a step.
        selection: what is recorded; outputs that are neither recorded nor connected aren't read.

    Attributes:
        inputs, outputs: ports, in the order of `System.slaves`; their signals are those of the current instant.
        couplings: (source, target) → how its signals get there.
        active: index of the slave that is being called, or was last; in memory that child processes share.
        exchange_steps: what an exchange consists of, in order.
        updating: steps of slaves that move on to their next state at the end of an exchange.
        predicting: slaves that announce their outputs, with their indices and ports.
        samples: whether there are slaves that sample.
        rounds: further rounds of an exchange where signals may jump.
        stepping, advance: steps all slaves from one communication point to the next [s] and reads them.
    """

    def __init__(self, system: System, grid: TimeGrid, algorithm: Algorithm, selection: Selection = EVERYTHING) -> None:
        # buffers: how each signal travels, and a port for each slave's inputs and outputs
        self.couplings = couplings(system, algorithm)
        self.inputs, self.outputs = wire(system, self.couplings, selection)
        self.active = c_int.from_buffer(mmap(-1, sizeof(c_int)))
        self._system = system
        self._grid = grid
        self._with_state = [slave for slave in system.slaves if needs_rollback(slave)]
        self.samples = any(isinstance(slave, Sampled) for slave in system.slaves)
        # the exchange: slaves in order, loops between them, and announcements before them
        stale = stale_after_step(system, self.couplings)
        steps = plan_exchange_steps(system, self.inputs, self.outputs, grid, stale)
        self.exchange_steps = self._with_loops(steps)
        self.updating = [each for each in steps if each.update is not None]
        self.predicting = [
            (i, slave, port)
            for i, (slave, port) in enumerate(zip(system.slaves, self.outputs, strict=True))
            if isinstance(slave, PredictsOutputs)
        ]
        self.rounds = loop_order(system, self.couplings)
        # the step
        ports = self.inputs, self.outputs
        self.stepping = Stepping(system, algorithm, ports, self.couplings, self.active)
        self.advance = self.stepping.advance

    def initialize(self, tolerance: float | None) -> None:
        """Initialise the slaves, each with the outputs of those before it, and read them.

        Nothing of an earlier run is left.
        """
        self._reset()
        # in the order of the exchange, so that a slave is initialised with inputs from those before it
        start, stop = float(self._grid.times[0]), float(self._grid.times[-1])
        ready: list[OutputPort] = []
        for i in dict.fromkeys([*self._system.visits, *range(len(self._system.slaves))]):
            slave, inputs, outputs = self._system.slaves[i], self.inputs[i], self.outputs[i]
            self.active.value = i
            for _, source, port in self.predicting:
                if port is outputs:
                    source.prepare(self._grid.times)
            inputs.preset(ready)
            slave.initialize(start, stop, tolerance)
            outputs.read(start)
            ready.append(outputs)

    @property
    def active_name(self) -> str:
        """Name of the slave that is being called, or was last."""
        return self._system.slaves[self.active.value].name

    def _reset(self) -> None:
        """Forget the run before."""
        for inputs, outputs in zip(self.inputs, self.outputs, strict=True):
            inputs.reset()
            outputs.reset()
        for step in self.exchange_steps:
            if isinstance(step, InstantLoop):
                step.reset()
        self.stepping.reset()

    def exchange(self, point: int, time: float, jump: bool) -> None:
        """Pass on the outputs at a communication point; afterwards all is ready for the step that begins there.

        Args:
            point: index of the communication point, or `OFF_GRID`.
            time: its time [s].
            jump: whether signals may jump, as they may at the start: all outputs are read anew.
        """
        # polynomials of the coming step
        for i, source, port in self.predicting:
            self.active.value = i
            source.announce(time)
            port.read_announced()
        self._pass_on(point, time, jump)
        if jump:
            # the k-th derivative of an output depends on derivatives of the inputs up to the k-th: round closed loops
            # one more is right after each round
            for _ in range(self.rounds):
                self._pass_on(OFF_GRID, time, True)
            # all slaves have sampled: now they may move on to their next states
            for step in self.updating:
                if step.due[point] and step.update is not None:
                    self.active.value = step.index
                    step.update(time)

    def _pass_on(self, point: int, time: float, jump: bool) -> None:
        """Carry out the exchange steps: set, sample and read one slave after the other."""
        active = self.active
        for step in self.exchange_steps:
            if isinstance(step, InstantLoop):
                step.solve(point, time)
                continue
            active.value = step.index
            step.inputs.exchange()
            if step.sample is not None and step.due[point]:
                step.sample(time)
            if jump or step.stale:
                step.outputs.read(time)

    def refresh(self, time: float, ports: Iterable[OutputPort]) -> None:
        """Pass on the outputs without sampling and read these ports, so that all that depends on inputs directly is up
        to date."""
        self._pass_on(OFF_GRID, time, False)
        for port in ports:
            port.read(time)

    def begin(self, *times: float, jump: bool = False) -> None:
        """Choose the coming communication points, from the current or a restored one on, and begin the first step.

        Args:
            times: [s].
            jump: whether signals may jump at the first one.
        """
        for i, source, _ in self.predicting:
            self.active.value = i
            source.prepare(np.array(times))
        if self.predicting or jump:
            # all others are as they were saved, with their inputs
            self.exchange(OFF_GRID, times[0], jump)

    def save(self) -> Snapshot:
        """Where all is now, inputs set, to come back to."""
        return Snapshot(StateKeeper(self._with_state), [port.signals.copy() for port in self.outputs])

    def restore(self, snapshot: Snapshot) -> None:
        """Go back; follow it by `begin`."""
        snapshot.states.restore()
        for port, signals in zip(self.outputs, snapshot.signals, strict=True):
            port.signals[:] = signals

    def _with_loops(self, steps: Sequence[ExchangeStep]) -> list[ExchangeStep | InstantLoop]:
        """The steps in the order of `System.exchange_order`, without idle ones."""
        found: list[ExchangeStep | InstantLoop] = []
        rest = iter(steps)
        for each in self._system.exchange_order:
            if isinstance(each, AlgebraicLoop):
                members = [next(rest) for _ in each.slaves]
                found.append(InstantLoop(each, members, self._unknowns(each), self.active))
                continue
            step = next(rest)
            if step.inputs.groups or step.due:
                found.append(step)
        return found

    def _unknowns(self, loop: AlgebraicLoop) -> LoopSignals:
        """The signals that a loop assumes, with as many derivatives as go round it."""
        signals: dict[OutputPort, tuple[Indices, int]] = {}
        for slave in dict.fromkeys(slave for slave, _ in loop.unknowns):
            indices = [index for each, index in loop.unknowns if each == slave]
            orders = [
                self.couplings[slave, target].order for target in loop.slaves if (slave, target) in self.couplings
            ]
            columns = np.searchsorted(self.outputs[slave].indices, indices)
            signals[self.outputs[slave]] = columns, 1 + max(orders)
        return LoopSignals(signals)


@dataclass(frozen=True)
class Snapshot:
    """States of all slaves that can be stepped back, and the signals (orders + 1, n) of all outputs."""

    states: StateKeeper
    signals: Sequence[RealArray]
