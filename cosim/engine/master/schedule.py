"""The plan of a run, and its execution in Python.

A run alternates between steps and exchanges. A step takes all slaves to the next communication point. The exchange
there prepares the next step: slaves that predict their outputs announce them, signals are passed on in the order of
direct feedthrough while sampled slaves sample, and where signals jump, derivatives are passed round closed loops again.

The plan is data. `Schedule` binds each operation to a Python call once, and a run executes lists of calls;
`flexfmu.cosim.engine.master.compiled_loop` translates the same operations into instructions for the loop in C.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from ctypes import c_int, sizeof
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
from mmap import mmap
from typing import NamedTuple, cast

import numpy as np

from flexfmu.cosim.engine.master import loops
from flexfmu.cosim.engine.master.couplings import (
    Algorithm,
    Couplings,
    StepGroup,
    couplings,
    loop_order,
    stale_after_step,
    step_groups,
)
from flexfmu.cosim.engine.master.grid import Block, RunGrid
from flexfmu.cosim.engine.master.ports import OutputPort, TimedCall, columns, wire
from flexfmu.cosim.engine.master.system import AlgebraicLoop, System
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.engine.slave import Indices, PredictsOutputs, RealArray, Sampled, SamplesInTwoPhases


class Action(Enum):
    """Kind of an operation on a slave."""

    ANNOUNCE = auto()
    """It announces the polynomials of its outputs over the next step, which are read."""
    FEED = auto()
    """Its inputs are set to the connected outputs at the current instant."""
    SAMPLE = auto()
    """It samples in one call: new outputs and new state."""
    OUTPUT = auto()
    """It calculates the outputs of a sample, without changing its state."""
    UPDATE = auto()
    """It calculates the new state of a sample, without changing its outputs."""
    READ = auto()
    """Its outputs are read and checked to be finite."""
    REMEMBER = auto()
    """The signals that feed it are kept at the beginning of the step, for interpolation."""
    INTERPOLATE = auto()
    """Its inputs are set to polynomials that interpolate between both ends of the step."""
    STEP = auto()
    """It is stepped."""
    SOLVE = auto()
    """The operations of a loop are iterated until its signals agree."""


class When(IntEnum):
    """At which points an operation is executed; the numbers of ``master.h``."""

    ALWAYS = 0
    AT_JUMPS = 1
    """Where signals may jump."""
    WHEN_DUE = 2
    """Where the slave samples."""


class Operation(NamedTuple):
    """One operation on a slave, or the iteration of a loop.

    Attributes:
        action: kind of operation.
        slave: index of the slave; of a loop the first one.
        when: at which points it is executed.
        loop: the loop to solve, at an instant or over a step; None for other operations.
        body: the operations of one round of the loop.
    """

    action: Action
    slave: int
    when: When = When.ALWAYS
    loop: AlgebraicLoop | StepGroup | None = None
    body: tuple[Operation, ...] = ()


Operations = tuple[Operation, ...]


@dataclass(frozen=True)
class Plan:
    """All operations of a run, in order.

    Attributes:
        start: indices of the slaves in the order in which they are initialised and read; the inputs of each are set to
            the outputs of those before it.
        step: operations from one communication point to the next.
        passing: operations that pass all signals from outputs to inputs at an instant, and sample.
        exchange: operations at a communication point; they contain ``passing``.
    """

    start: tuple[int, ...]
    step: Operations
    passing: Operations
    exchange: Operations

    @property
    def has_loops(self) -> bool:
        """Whether a loop is iterated."""
        return any(each.action is Action.SOLVE for each in (*self.step, *self.exchange))


def make_plan(system: System, couplings: Couplings, algorithm: Algorithm) -> Plan:
    """The plan for a system.

    Args:
        system: slaves and connections.
        couplings: (source, target) → their coupling.
        algorithm: how slaves are coupled over a step.
    """
    # sampled slaves: in one call, or in two phases with the outputs first
    sampling = {
        i: Action.OUTPUT if isinstance(slave, SamplesInTwoPhases) else Action.SAMPLE
        for i, slave in enumerate(system.slaves)
        if isinstance(slave, Sampled)
    }
    positions = sampling_positions(system)
    passing = _passing(system, stale_after_step(system, couplings), sampling, positions)
    # exchange: polynomials of the next step first, since the signals passed on depend on them
    exchange = [
        Operation(Action.ANNOUNCE, i) for i, slave in enumerate(system.slaves) if isinstance(slave, PredictsOutputs)
    ]
    exchange += passing
    # the k-th derivative of an output depends on derivatives of the inputs up to the k-th: in closed loops each further
    # round makes one more derivative correct
    exchange += _without_samples(passing) * loop_order(system, couplings)
    # after all outputs: new states of the slaves that sample in two phases
    exchange += [
        Operation(Action.UPDATE, i, When.WHEN_DUE)
        for i in sorted(positions, key=lambda i: positions[i])
        if sampling.get(i) is Action.OUTPUT
    ]
    # slaves are initialised in the order of the exchange, so that their inputs can be set from those before
    start = tuple(dict.fromkeys([*system.exchange_steps, *range(len(system.slaves))]))
    return Plan(start, _step(system, couplings, algorithm), passing, tuple(exchange))


def _passing(
    system: System, stale: frozenset[int], sampling: Mapping[int, Action], positions: Mapping[int, int]
) -> Operations:
    """Operations that set, sample and read one slave after the other; loops are solved in their place.

    Args:
        system: slaves and connections.
        stale: slaves whose outputs must be read again even where nothing jumps.
        sampling: sampled slave → `Action.SAMPLE` or `Action.OUTPUT`.
        positions: slave → exchange step in which it samples in one call; in two phases it calculates its outputs in
            each of its exchange steps.
    """
    operations: list[Operation] = []
    # exchange steps in order; position is the number of the step
    connected = {each.target for each in system.connections}
    position = 0
    for each in system.exchange_order:
        members = each.slaves if isinstance(each, AlgebraicLoop) else (each,)
        body: list[Operation] = []
        for i in members:
            # a sample, if it belongs to this exchange step
            samples: list[Operation] = []
            if i in sampling and (sampling[i] is Action.OUTPUT or positions[i] == position):
                samples = [Operation(sampling[i], i, When.WHEN_DUE)]
            position += 1
            # slaves without connected inputs and samples need no operation
            if i in connected or samples:
                read = When.ALWAYS if i in stale or isinstance(each, AlgebraicLoop) else When.AT_JUMPS
                body += [Operation(Action.FEED, i), *samples, Operation(Action.READ, i, read)]
        if isinstance(each, AlgebraicLoop):
            body = [Operation(Action.SOLVE, members[0], loop=each, body=tuple(body))]
        operations += body
    return tuple(operations)


def _without_samples(operations: Iterable[Operation]) -> Operations:
    """The same operations without samples, for a further round where signals jump."""
    return tuple(
        each._replace(when=When.AT_JUMPS, body=_without_samples(each.body))
        for each in operations
        if each.action not in (Action.SAMPLE, Action.OUTPUT)
    )


def _step(system: System, couplings: Couplings, algorithm: Algorithm) -> Operations:
    """Operations of a step: all stepped slaves, sources first; closed loops are iterated if the algorithm says so."""
    groups = step_groups(system, algorithm)
    interpolating = {target for (_, target), coupling in couplings.items() if coupling.ends is not None}
    # keep all signals at the beginning of the step, before any slave is stepped
    operations = [Operation(Action.REMEMBER, i) for group in groups for i in group.slaves if i in interpolating]
    for group in groups:
        body: list[Operation] = []
        for i in group.slaves:
            # interpolate the inputs whose sources are at the end already, then step
            if i in interpolating:
                body.append(Operation(Action.INTERPOLATE, i))
            body += [Operation(Action.STEP, i), Operation(Action.READ, i)]
        # an iterated group is one operation
        if group.solver is not None:
            body = [Operation(Action.SOLVE, group.slaves[0], loop=group, body=tuple(body))]
        operations += body
    return tuple(operations)


def sampling_positions(system: System) -> Mapping[int, int]:
    """Slave → index in `System.exchange_steps` at which all inputs for a sample in one call are up to date."""
    positions: dict[int, int] = {}
    in_loop: dict[int, int] = {}
    position = 0
    for each in system.exchange_order:
        for slave in each.slaves if isinstance(each, AlgebraicLoop) else [each]:
            positions[slave] = position
            if isinstance(each, AlgebraicLoop):
                in_loop[slave] = position
            position += 1
    # a slave in an algebraic loop samples within the loop, which is solved with its outputs
    return positions | in_loop


OFF_GRID = -1
"""Index of communication points that step control inserts off the grid; the last entry of `Schedule.due`."""


class Schedule:
    """Executes exchanges and steps of a system on a time grid; one schedule serves several runs, one after the other.

    Args:
        system: slaves and connections.
        grid: communication points of the runs.
        algorithm: how slaves are coupled over a step.
        selection: outputs to record; outputs that are neither recorded nor connected aren't read.

    Attributes:
        system, grid: the arguments.
        slaves: the slaves.
        inputs, outputs: ports, in the order of ``slaves``; their signals are those of the current instant.
        couplings: (source, target) → their coupling.
        plan: all operations in order.
        due: index of a sampled slave → whether it samples at each communication point of the current block, as bytes;
            the last entry, 0, is for points off the grid.
        active: index of the slave that is being called, or was last, in memory shared with child processes.
        predicting: index → slave that predicts its outputs.

    Raises:
        InputError: a slave's step must be iterated, but the slave can't save and restore its state.
    """

    def __init__(self, system: System, grid: RunGrid, algorithm: Algorithm, selection: Selection = EVERYTHING) -> None:
        # couplings, and ports for each slave's inputs and outputs
        self.slaves = system.slaves
        self.couplings = couplings(system, algorithm)
        self.inputs, self.outputs = wire(system, self.couplings, selection)
        self.active = c_int.from_buffer(mmap(-1, sizeof(c_int)))
        self.system, self.grid = system, grid
        self._with_state = [slave for slave in system.slaves if loops.needs_rollback(slave)]
        self.plan = plan = make_plan(system, self.couplings, algorithm)
        announcing = [each.slave for each in plan.exchange if each.action is Action.ANNOUNCE]
        self.predicting = {i: cast(PredictsOutputs, system.slaves[i]) for i in announcing}
        sampled = [i for i, slave in enumerate(system.slaves) if isinstance(slave, Sampled)]
        self.due = {i: bytearray(grid.most + 2) for i in sampled}
        # lists of calls, bound once since a run spends its time in them; fewer calls where no signal jumps
        self._unknowns: dict[str, loops.LoopSignals] = {}
        self._step = [(each.slave, self.bind(each)) for each in plan.step]
        exchange = [(each, self.bind(each)) for each in plan.exchange]
        self._at_jump = [(each.slave, call) for each, call in exchange]
        self._between = [(each.slave, call) for each, call in exchange if each.when is not When.AT_JUMPS]
        self._passing = [(each.slave, self.bind(each)) for each in plan.passing if each.when is When.ALWAYS]

    def move_to(self, grid: RunGrid) -> None:
        """Run over these communication points from now on."""
        self.grid = grid
        for i in self.due:
            self.due[i] = bytearray(grid.most + 2)

    @property
    def active_name(self) -> str:
        """Name of the slave that is being called, or was last."""
        return self.slaves[self.active.value].name

    def initialize(self, first: Block, tolerance: float | None) -> None:
        """Reset all signals, then initialise the slaves, each with inputs from those before it, and read their outputs.

        Args:
            first: the first communication points.
            tolerance: relative tolerance for the slaves' own integrators; None for their default.
        """
        # reset the signals of an earlier run
        for inputs, outputs in zip(self.inputs, self.outputs, strict=True):
            inputs.reset()
            outputs.reset()
        for signals in self._unknowns.values():
            signals.reset()
        # initialise one slave after the other, with inputs from those that are ready
        start, stop = self.grid.start, self.grid.stop
        ready: list[OutputPort] = []
        self._set_due(first)
        for i in self.plan.start:
            self.active.value = i
            if i in self.predicting:
                self.predicting[i].prepare(first.known)
            self.inputs[i].preset(ready)
            self.slaves[i].initialize(start, stop, tolerance)
            self.outputs[i].read(start)
            ready.append(self.outputs[i])

    def enter(self, block: Block) -> None:
        """Go on to the next communication points, after the exchange at the first of them."""
        self._set_due(block)
        for i, source in self.predicting.items():
            self.active.value = i
            source.prepare(block.known)

    def _set_due(self, block: Block) -> None:
        """Set where sampled slaves are due."""
        for due, flags in zip(self.due.values(), block.grid.due, strict=True):
            due[: flags.size] = flags.tobytes()

    def advance(self, begin: float, end: float) -> None:
        """Step all slaves from one communication point to the next [s] and read their outputs."""
        active = self.active
        for slave, call in self._step:
            active.value = slave
            call(OFF_GRID, begin, end)

    def exchange(self, point: int, time: float, jump: bool) -> None:
        """Execute the exchange at a communication point, which prepares the next step.

        Args:
            point: index of the communication point, or `OFF_GRID`.
            time: its time [s].
            jump: whether signals may jump, as at the start; then all outputs are read again.
        """
        active = self.active
        for slave, call in self._at_jump if jump else self._between:
            active.value = slave
            call(point, time, time)

    def refresh(self, time: float, ports: Iterable[OutputPort]) -> None:
        """Pass on the outputs at ``time`` [s] without sampling and read these ports.

        Afterwards all outputs with direct feedthrough are up to date.
        """
        for slave, call in self._passing:
            self.active.value = slave
            call(OFF_GRID, time, time)
        for port in ports:
            port.read(time)

    def begin(self, *times: float, jump: bool = False) -> None:
        """Set the next communication points and prepare the first step.

        Args:
            times: communication points [s]; the first is the current time, or that of a restored snapshot.
            jump: whether signals may jump at the first one.
        """
        for i, source in self.predicting.items():
            self.active.value = i
            source.prepare(np.array(times))
        if self.predicting or jump:
            # otherwise no exchange is needed: saved states include the inputs
            self.exchange(OFF_GRID, times[0], jump)

    def save(self) -> Snapshot:
        """A snapshot of the slaves, with the inputs that are set now, and of all output signals."""
        return Snapshot(loops.StateKeeper(self._with_state), [port.signals.copy() for port in self.outputs])

    def restore(self, snapshot: Snapshot) -> None:
        """Roll back to a snapshot; call `begin` afterwards."""
        snapshot.states.restore()
        for port, signals in zip(self.outputs, snapshot.signals, strict=True):
            port.signals[:] = signals

    def bind(self, operation: Operation) -> TimedCall:
        """The call that executes an operation; one that samples checks itself whether the slave is due."""
        i = operation.slave
        slave, inputs, outputs = self.slaves[i], self.inputs[i], self.outputs[i]
        match operation.action:
            # at an instant
            case Action.ANNOUNCE:
                announce, read = self.predicting[i].announce, outputs.read_announced
                return lambda point, begin, end: (announce(begin), read())
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
            # loops, and outputs
            case Action.SOLVE:
                return self._solution(operation)
            case _:
                return outputs.reading()

    def _solution(self, operation: Operation) -> TimedCall:
        """The call that solves a loop, at an instant or over a step."""
        loop, body = operation.loop, operation.body
        calls: list[loops.LoopCall] = [
            (each.slave, self.bind(each), self.outputs[each.slave] if each.action is Action.READ else None)
            for each in body
        ]
        if isinstance(loop, AlgebraicLoop):
            # slaves that sample in one call are rolled back
            sampling = [
                (self.slaves[each.slave], self.due[each.slave]) for each in body if each.action is Action.SAMPLE
            ]
            # all rounds of an exchange share the loop's unknowns and their magnitudes
            signals = self._unknowns.setdefault(loop.name, self._unknowns_at_instant(loop))
            return loops.solution(loop.solver, loop.name, calls, sampling, signals, self.active, at_instant=True)
        assert loop is not None
        assert loop.solver is not None
        name = ", ".join(self.system.describe(each) for each in loop.torn)
        signals = self._unknowns.setdefault(name, self._unknowns_of_step(loop))
        members = [self.slaves[i] for i in loop.slaves]
        loops.check_can_save(members, "repeating a step")
        repeated = [(slave, None) for slave in members]
        return loops.solution(loop.solver, name, calls, repeated, signals, self.active, at_instant=False)

    def _unknowns_at_instant(self, loop: AlgebraicLoop) -> loops.LoopSignals:
        """The unknowns of an algebraic loop, with as many derivatives as its couplings pass round."""
        unknowns: dict[OutputPort, tuple[Indices, int]] = {}
        for slave in dict.fromkeys(slave for slave, _ in loop.unknowns):
            indices = [index for each, index in loop.unknowns if each == slave]
            pairs = [(slave, target) for target in loop.slaves if (slave, target) in self.couplings]
            rows = 1 + max(self.couplings[pair].order for pair in pairs)
            unknowns[self.outputs[slave]] = np.searchsorted(self.outputs[slave].indices, indices), rows
        return loops.LoopSignals(unknowns)

    def _unknowns_of_step(self, group: StepGroup) -> loops.LoopSignals:
        """The unknowns of an iterated step: signals at its end that feed slaves stepped before their sources."""
        unknowns: dict[OutputPort, tuple[Indices, int]] = {}
        for source in dict.fromkeys(each.source for each in group.torn):
            torn = [each for each in group.torn if each.source == source]
            rows = 1 + max(self.couplings[each.source, each.target].ends or 0 for each in torn)
            port = self.outputs[source]
            unknowns[port] = np.unique(columns(port, torn)), rows
        return loops.LoopSignals(unknowns)


def _where_due(due: Sequence[int], sample: Callable[[float], None]) -> TimedCall:
    """A call that samples at the points where the slave is due."""

    def call(point: int, begin: float, end: float) -> None:
        if due[point]:
            sample(end)

    return call


@dataclass(frozen=True)
class Snapshot:
    """Saved states of all slaves that need rollback, and the signals (orders + 1, n) of each output port."""

    states: loops.StateKeeper
    signals: Sequence[RealArray]
