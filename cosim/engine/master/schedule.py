"""Carries out a plan in Python: each operation is bound to a call once, and a run goes through lists of calls.

The order of calls is that of `flexfmu.cosim.engine.master.plan`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from ctypes import c_int, sizeof
from dataclasses import dataclass
from mmap import mmap
from typing import cast

import numpy as np

from flexfmu.cosim.engine.master.algorithms import Algorithm
from flexfmu.cosim.engine.master.couplings import StepGroup, couplings
from flexfmu.cosim.engine.master.grid import TimeGrid
from flexfmu.cosim.engine.master.loops import (
    InstantLoop,
    IteratedStep,
    LoopCall,
    LoopSignals,
    StateKeeper,
    needs_rollback,
)
from flexfmu.cosim.engine.master.plan import Action, Operation, When, make_plan
from flexfmu.cosim.engine.master.ports import OutputPort, TimedCall, columns, wire
from flexfmu.cosim.engine.master.system import AlgebraicLoop, System
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.engine.slave import Indices, PredictsOutputs, RealArray, Sampled, SamplesInTwoPhases

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
        slaves: the slaves.
        inputs, outputs: ports, in the order of ``slaves``; their signals are those of the current instant.
        couplings: (source, target) → how its signals get there.
        plan: all operations in order.
        due: slave that samples → whether it does so at each communication point of the grid, and once more False for
            points off the grid.
        active: index of the slave that is being called, or was last; in memory that child processes share.
        predicting: index → slave that announces its outputs.

    Raises:
        InputError: a step of a slave would have to be repeated, but it can't go back.
    """

    def __init__(self, system: System, grid: TimeGrid, algorithm: Algorithm, selection: Selection = EVERYTHING) -> None:
        # buffers: how each signal travels, and a port for each slave's inputs and outputs
        self.slaves = system.slaves
        self.couplings = couplings(system, algorithm)
        self.inputs, self.outputs = wire(system, self.couplings, selection)
        self.active = c_int.from_buffer(mmap(-1, sizeof(c_int)))
        self._system, self._grid = system, grid
        self._with_state = [slave for slave in system.slaves if needs_rollback(slave)]
        self.plan = plan = make_plan(system, self.couplings, algorithm)
        announcing = [each.slave for each in plan.exchange if each.action is Action.ANNOUNCE]
        self.predicting = {i: cast(PredictsOutputs, system.slaves[i]) for i in announcing}
        sampled = [i for i, slave in enumerate(system.slaves) if isinstance(slave, Sampled)]
        self.due = {i: (*flags.tolist(), False) for i, flags in zip(sampled, grid.due, strict=True)}
        # calls: bound once, this is what a run spends its time with; where nothing jumps there are fewer
        self._unknowns: dict[str, LoopSignals] = {}
        self._step = [(each.slave, self.bind(each)) for each in plan.step]
        exchange = [(each, self.bind(each)) for each in plan.exchange]
        self._at_jump = [(each.slave, call) for each, call in exchange]
        self._between = [(each.slave, call) for each, call in exchange if each.when is not When.AT_JUMPS]
        self._passing = [(each.slave, self.bind(each)) for each in plan.passing if each.when is When.ALWAYS]

    @property
    def active_name(self) -> str:
        """Name of the slave that is being called, or was last."""
        return self.slaves[self.active.value].name

    def initialize(self, tolerance: float | None) -> None:
        """Initialise the slaves, each with the outputs of those before it, and read them.

        Nothing of an earlier run is left.
        """
        # forget the run before
        for inputs, outputs in zip(self.inputs, self.outputs, strict=True):
            inputs.reset()
            outputs.reset()
        for signals in self._unknowns.values():
            signals.reset()
        # one slave after the other, with the signals of those that are ready
        start, stop = float(self._grid.times[0]), float(self._grid.times[-1])
        ready: list[OutputPort] = []
        for i in self.plan.start:
            self.active.value = i
            if i in self.predicting:
                self.predicting[i].prepare(self._grid.times)
            self.inputs[i].preset(ready)
            self.slaves[i].initialize(start, stop, tolerance)
            self.outputs[i].read(start)
            ready.append(self.outputs[i])

    def advance(self, begin: float, end: float) -> None:
        """Step all slaves from one communication point to the next [s] and read them."""
        active = self.active
        for slave, call in self._step:
            active.value = slave
            call(OFF_GRID, begin, end)

    def exchange(self, point: int, time: float, jump: bool) -> None:
        """Pass on the outputs at a communication point; afterwards all is ready for the step that begins there.

        Args:
            point: index of the communication point, or `OFF_GRID`.
            time: its time [s].
            jump: whether signals may jump, as they may at the start: all outputs are read anew.
        """
        active = self.active
        for slave, call in self._at_jump if jump else self._between:
            active.value = slave
            call(point, time, time)

    def refresh(self, time: float, ports: Iterable[OutputPort]) -> None:
        """Pass on the outputs without sampling and read these ports, so that all that depends on inputs directly is up
        to date."""
        for slave, call in self._passing:
            self.active.value = slave
            call(OFF_GRID, time, time)
        for port in ports:
            port.read(time)

    def begin(self, *times: float, jump: bool = False) -> None:
        """Choose the coming communication points, from the current or a restored one on, and begin the first step.

        Args:
            times: [s].
            jump: whether signals may jump at the first one.
        """
        for i, source in self.predicting.items():
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

    def bind(self, operation: Operation) -> TimedCall:
        """The call that carries out an operation; one that samples looks itself whether the slave is due."""
        i = operation.slave
        slave, inputs, outputs = self.slaves[i], self.inputs[i], self.outputs[i]
        match operation.action:
            # at an instant
            case Action.ANNOUNCE:
                return _announcement(self.predicting[i].announce, outputs.read_announced)
            case Action.FEED:
                return inputs.feeding()
            case Action.SAMPLE:
                return _where_due(self.due[i], cast(Sampled, slave).sample)
            case Action.OUTPUT:
                return _where_due(self.due[i], cast(SamplesInTwoPhases, slave).output)
            case Action.UPDATE:
                return _where_due(self.due[i], cast(SamplesInTwoPhases, slave).update)
            # over a step
            case Action.REMEMBER:
                return lambda point, begin, end: inputs.remember()
            case Action.INTERPOLATE:
                return lambda point, begin, end: inputs.interpolate(end - begin)
            case Action.STEP:
                step = slave.step
                return lambda point, begin, end: step(begin, end - begin)
            # both
            case Action.SOLVE:
                return self._solution(operation)
            case _:
                return outputs.reading()

    def _solution(self, operation: Operation) -> TimedCall:
        """The call that solves a loop."""
        loop, body = operation.loop, operation.body
        calls = [
            LoopCall(each.slave, self.bind(each), self.outputs[each.slave] if each.action is Action.READ else None)
            for each in body
        ]
        if isinstance(loop, AlgebraicLoop):
            sampling = [
                (self.slaves[each.slave], self.due[each.slave]) for each in body if each.action is Action.SAMPLE
            ]
            # a further round of an exchange goes on with what the first has learned of the magnitudes
            signals = self._unknowns.setdefault(loop.name, self._unknowns_at_instant(loop))
            return InstantLoop(loop, calls, sampling, signals, self.active).solve
        assert loop is not None
        assert loop.solver is not None
        name = ", ".join(self._system.describe(each) for each in loop.torn)
        signals = self._unknowns.setdefault(name, self._unknowns_of_step(loop))
        members = [self.slaves[i] for i in loop.slaves]
        return IteratedStep(loop.solver, name, members, calls, signals, self.active).solve

    def _unknowns_at_instant(self, loop: AlgebraicLoop) -> LoopSignals:
        """The signals that a loop assumes, with as many derivatives as go round it."""
        unknowns: dict[OutputPort, tuple[Indices, int]] = {}
        for slave in dict.fromkeys(slave for slave, _ in loop.unknowns):
            indices = [index for each, index in loop.unknowns if each == slave]
            pairs = [(slave, target) for target in loop.slaves if (slave, target) in self.couplings]
            rows = 1 + max(self.couplings[pair].order for pair in pairs)
            unknowns[self.outputs[slave]] = np.searchsorted(self.outputs[slave].indices, indices), rows
        return LoopSignals(unknowns)

    def _unknowns_of_step(self, group: StepGroup) -> LoopSignals:
        """The signals at the end of a step that slaves assume which are advanced before their sources."""
        unknowns: dict[OutputPort, tuple[Indices, int]] = {}
        for source in dict.fromkeys(each.source for each in group.torn):
            torn = [each for each in group.torn if each.source == source]
            rows = 1 + max(self.couplings[each.source, each.target].ends or 0 for each in torn)
            port = self.outputs[source]
            unknowns[port] = np.unique(columns(port, torn)), rows
        return LoopSignals(unknowns)


def _announcement(announce: Callable[[float], None], read: Callable[[], None]) -> TimedCall:
    """Change over to the polynomials of the coming step, and read them."""

    def call(point: int, begin: float, end: float) -> None:
        announce(begin)
        read()

    return call


def _where_due(due: Sequence[bool], sample: Callable[[float], None]) -> TimedCall:
    """Sample at the points where the slave is due."""

    def call(point: int, begin: float, end: float) -> None:
        if due[point]:
            sample(end)

    return call


@dataclass(frozen=True)
class Snapshot:
    """States of all slaves that can be stepped back, and the signals (orders + 1, n) of all outputs."""

    states: StateKeeper
    signals: Sequence[RealArray]
