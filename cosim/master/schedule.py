"""The order of a run: who is initialised, set, read, sampled and stepped when."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from flexfmu.cosim.master.activity import Activity
from flexfmu.cosim.master.algorithms import Algorithm
from flexfmu.cosim.master.grid import TimeGrid
from flexfmu.cosim.master.instant_loop import InstantLoop
from flexfmu.cosim.master.links import couplings, loop_order, stale_after_step, wire
from flexfmu.cosim.master.loop_signals import LoopSignals
from flexfmu.cosim.master.ports import OutputPort
from flexfmu.cosim.master.selection import EVERYTHING, Selection
from flexfmu.cosim.master.state import StateKeeper, revocable
from flexfmu.cosim.master.stepping import Stepping
from flexfmu.cosim.master.system import AlgebraicLoop, System
from flexfmu.cosim.master.visit import Visit, plan_visits
from flexfmu.cosim.slave import Indices, KnowsItsFuture, RealArray, Sampled

OFF_GRID = -1
"""Stands for the index of a communication point that step control has put between those of the grid."""


class Schedule:
    """Exchanges and steps of a system on a time grid, for one run after the other.

    Args:
        system: slaves and connections.
        grid: the points of the runs.
        algorithm: how slaves are coupled over a step.
        selection: what is recorded; what nobody is fed with either isn't read.

    Attributes:
        inputs, outputs: ports, in the order of `System.slaves`; their signals are those of the current instant.
        couplings: (source, target) → how its signals get there.
        activity: which slave is, or was last, at work.
        turns, updating: who has a turn in an exchange, and who moves on to the next state at its end.
        futures: slaves that announce what comes, with their indices and ports.
        samples: whether there are slaves that sample.
        rounds: further rounds of an exchange where signals may jump.
        stepping, advance: steps all slaves from one communication point to the next [s] and reads them.
    """

    def __init__(self, system: System, grid: TimeGrid, algorithm: Algorithm, selection: Selection = EVERYTHING) -> None:
        self.couplings = couplings(system, algorithm)
        self.inputs, self.outputs = wire(system, self.couplings, selection)
        self.activity = Activity.of([slave.name for slave in system.slaves])
        self._system = system
        self._revocable = revocable(system.slaves)
        self.samples = any(isinstance(slave, Sampled) for slave in system.slaves)
        self._grid = grid
        stale = stale_after_step(system, self.couplings)
        visits = plan_visits(system, self.inputs, self.outputs, grid, stale)
        self.turns = self._with_loops(visits)
        self.updating = [visit for visit in visits if visit.update is not None]
        self.futures = [
            (i, slave, port)
            for i, (slave, port) in enumerate(zip(system.slaves, self.outputs, strict=True))
            if isinstance(slave, KnowsItsFuture)
        ]
        self.rounds = loop_order(system, self.couplings)
        ports = self.inputs, self.outputs
        self.stepping = Stepping(system, algorithm, ports, self.couplings, self.activity)
        self.advance = self.stepping.advance

    def initialize(self, tolerance: float | None) -> None:
        """Initialise the slaves, each with the outputs of those before it, and read them.

        Nothing of an earlier run is left.
        """
        self._reset()
        start, stop = float(self._grid.times[0]), float(self._grid.times[-1])
        ready: list[OutputPort] = []
        for i in dict.fromkeys([*self._system.visits, *range(len(self._system.slaves))]):
            slave, inputs, outputs = self._system.slaves[i], self.inputs[i], self.outputs[i]
            self.activity.slave = i
            for _, future, port in self.futures:
                if port is outputs:
                    future.prepare(self._grid.times)
            inputs.preset(ready)
            slave.initialize(start, stop, tolerance)
            outputs.read(start)
            ready.append(outputs)

    def _reset(self) -> None:
        """Forget the run before."""
        for inputs, outputs in zip(self.inputs, self.outputs, strict=True):
            inputs.reset()
            outputs.reset()
        for turn in self.turns:
            if isinstance(turn, InstantLoop):
                turn.reset()
        self.stepping.reset()

    def exchange(self, point: int, time: float, jump: bool) -> None:
        """Pass on the outputs at a communication point; afterwards all is ready for the step that begins there.

        Args:
            point: index of the communication point, or `OFF_GRID`.
            time: its time [s].
            jump: whether signals may jump, as they may at the start: all outputs are read anew.
        """
        for i, future, port in self.futures:
            self.activity.slave = i
            future.announce(time)
            port.read_announced()
        self._pass_on(point, time, jump)
        if jump:
            # the k-th derivative of an output depends on derivatives of the inputs up to the k-th: round closed loops
            # one more is right after each round
            for _ in range(self.rounds):
                self._pass_on(OFF_GRID, time, True)
            for visit in self.updating:
                if visit.due[point] and visit.update is not None:
                    self.activity.slave = visit.index
                    visit.update(time)

    def _pass_on(self, point: int, time: float, jump: bool) -> None:
        """Everybody's turn."""
        activity = self.activity
        for turn in self.turns:
            if isinstance(turn, InstantLoop):
                turn.solve(point, time)
                continue
            activity.slave = turn.index
            turn.inputs.exchange()
            if turn.sample is not None and turn.due[point]:
                turn.sample(time)
            if jump or turn.stale:
                turn.outputs.read(time)

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
        for i, future, _ in self.futures:
            self.activity.slave = i
            future.prepare(np.array(times))
        if self.futures or jump:
            # all others are as they were saved, with their inputs
            self.exchange(OFF_GRID, times[0], jump)

    def save(self) -> Snapshot:
        """Where all is now, inputs set, to come back to."""
        return Snapshot(StateKeeper(self._revocable), [port.signals.copy() for port in self.outputs])

    def restore(self, snapshot: Snapshot) -> None:
        """Go back; follow it by `begin`."""
        snapshot.states.restore()
        for port, signals in zip(self.outputs, snapshot.signals, strict=True):
            port.signals[:] = signals

    def _with_loops(self, visits: Sequence[Visit]) -> list[Visit | InstantLoop]:
        """The turns in the order of `System.exchange_order`, without idle ones."""
        turns: list[Visit | InstantLoop] = []
        rest = iter(visits)
        for each in self._system.exchange_order:
            if isinstance(each, AlgebraicLoop):
                members = [next(rest) for _ in each.slaves]
                turns.append(InstantLoop(each, members, self._unknowns(each), self.activity))
                continue
            visit = next(rest)
            if visit.inputs.links or visit.due:
                turns.append(visit)
        return turns

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
