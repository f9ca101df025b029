"""The plan of a run: which slave is initialised, announced, set, sampled, read and stepped, in which order.

A run alternates between steps and exchanges. Over a step all slaves are advanced to the next communication point. There the
exchange makes them ready for the next step: slaves that predict their outputs announce them, signals are passed on in the order
of direct feedthrough while sampled slaves sample, and derivatives go round closed loops once more where signals jump.

The plan is data. `flexfmu.cosim.engine.master.schedule` binds each operation to a Python call;
`flexfmu.cosim.engine.master.program` translates the same operations for the loop in C.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
from typing import NamedTuple

from flexfmu.cosim.engine.master.algorithms import Algorithm
from flexfmu.cosim.engine.master.couplings import Couplings, StepGroup, loop_order, stale_after_step, step_groups
from flexfmu.cosim.engine.master.system import AlgebraicLoop, System
from flexfmu.cosim.engine.slave import PredictsOutputs, Sampled, SamplesInTwoPhases


class Action(Enum):
    """What is done to a slave."""

    ANNOUNCE = auto()
    """It changes over to its polynomials of the coming step, which are read."""
    FEED = auto()
    """Its inputs are set from the outputs at the current instant."""
    SAMPLE = auto()
    """It samples: new outputs, and on to its next state."""
    OUTPUT = auto()
    """It calculates the outputs of a sample; its state stays."""
    UPDATE = auto()
    """It moves on to the next state of a sample."""
    READ = auto()
    """Its outputs are read and checked."""
    REMEMBER = auto()
    """The signals at the beginning of the step are kept, for interpolation."""
    INTERPOLATE = auto()
    """Its inputs are set to polynomials between both ends of the step."""
    STEP = auto()
    """It is stepped."""
    SOLVE = auto()
    """The operations of a loop are repeated until its signals agree."""


class When(IntEnum):
    """When an operation is carried out; the numbers of ``master.h``."""

    ALWAYS = 0
    AT_JUMPS = 1
    """Where signals may jump."""
    WHEN_DUE = 2
    """Where the slave samples."""


class Operation(NamedTuple):
    """One call, or a loop of calls.

    Attributes:
        action: what is done.
        slave: to which slave, by its index; of a loop the first one.
        when: under which condition.
        loop: what is solved, at an instant or over a step.
        body: the operations that are repeated to solve it.
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
        start: slaves in the order in which they are initialised and read, each with outputs of those before it.
        step: from one communication point to the next.
        passing: signals go from output to input, once, at an instant.
        exchange: at a communication point.
    """

    start: tuple[int, ...]
    step: Operations
    passing: Operations
    exchange: Operations

    @property
    def has_loops(self) -> bool:
        """Whether operations are repeated until signals agree."""
        return any(each.action is Action.SOLVE for each in (*self.step, *self.exchange))


def make_plan(system: System, couplings: Couplings, algorithm: Algorithm) -> Plan:
    """The plan for a system.

    Args:
        system: slaves and connections.
        couplings: (source, target) → how its signals get there.
        algorithm: how slaves are coupled over a step.
    """
    # what a slave does at its sample instants: all in one call, or outputs first
    sampling = {
        i: Action.OUTPUT if isinstance(slave, SamplesInTwoPhases) else Action.SAMPLE
        for i, slave in enumerate(system.slaves)
        if isinstance(slave, Sampled)
    }
    positions = sampling_positions(system)
    passing = _passing(system, stale_after_step(system, couplings), sampling, positions)
    # at a communication point: polynomials of the coming step first, since what is passed on depends on them
    exchange = [
        Operation(Action.ANNOUNCE, i) for i, slave in enumerate(system.slaves) if isinstance(slave, PredictsOutputs)
    ]
    exchange += passing
    # the k-th derivative of an output depends on derivatives of the inputs up to the k-th: in closed loops one more of
    # them is right after each further round
    exchange += _without_samples(passing) * loop_order(system, couplings)
    # all slaves have sampled: those that sample in two phases may move on to their next states
    exchange += [
        Operation(Action.UPDATE, i, When.WHEN_DUE)
        for i in sorted(positions, key=lambda i: positions[i])
        if sampling.get(i) is Action.OUTPUT
    ]
    # slaves are initialised in the order of the exchange, so that each finds the outputs of those before it
    start = tuple(dict.fromkeys([*system.exchange_steps, *range(len(system.slaves))]))
    return Plan(start, _step(system, couplings, algorithm), passing, tuple(exchange))


def _passing(
    system: System, stale: frozenset[int], sampling: Mapping[int, Action], positions: Mapping[int, int]
) -> Operations:
    """Set, sample and read one slave after the other, loops in their place.

    Args:
        system: slaves and connections.
        stale: slaves whose outputs must be read anew even where nothing jumps.
        sampling: what slaves do at their sample instants.
        positions: exchange step of each slave in which it samples in one call; outputs alone are calculated in all of its.
    """
    operations: list[Operation] = []
    # each exchange step in its place, and which number it has
    connected = {each.target for each in system.connections}
    position = 0
    for each in system.exchange_order:
        members = each.slaves if isinstance(each, AlgebraicLoop) else (each,)
        body: list[Operation] = []
        for i in members:
            # which samples belong to this exchange step
            samples: list[Operation] = []
            if i in sampling and (sampling[i] is Action.OUTPUT or positions[i] == position):
                samples = [Operation(sampling[i], i, When.WHEN_DUE)]
            position += 1
            # without inputs and samples there is nothing to do
            if i in connected or samples:
                read = When.ALWAYS if i in stale or isinstance(each, AlgebraicLoop) else When.AT_JUMPS
                body += [Operation(Action.FEED, i), *samples, Operation(Action.READ, i, read)]
        if isinstance(each, AlgebraicLoop):
            body = [Operation(Action.SOLVE, members[0], loop=each, body=tuple(body))]
        operations += body
    return tuple(operations)


def _without_samples(operations: Iterable[Operation]) -> Operations:
    """The same operations for a further round where signals jump: no slave samples again."""
    return tuple(
        each._replace(when=When.AT_JUMPS, body=_without_samples(each.body))
        for each in operations
        if each.action not in (Action.SAMPLE, Action.OUTPUT)
    )


def _step(system: System, couplings: Couplings, algorithm: Algorithm) -> Operations:
    """Advance all slaves that are stepped, sources first; those that feed each other are repeated on demand."""
    groups = step_groups(system, algorithm)
    interpolating = {target for (_, target), coupling in couplings.items() if coupling.ends is not None}
    # all signals at the beginning of the step, before any of them moves on
    operations = [Operation(Action.REMEMBER, i) for group in groups for i in group.slaves if i in interpolating]
    for group in groups:
        body: list[Operation] = []
        for i in group.slaves:
            # inputs whose sources are at the end already, then the step
            if i in interpolating:
                body.append(Operation(Action.INTERPOLATE, i))
            body += [Operation(Action.STEP, i), Operation(Action.READ, i)]
        # a group that is repeated is one operation
        if group.solver is not None:
            body = [Operation(Action.SOLVE, group.slaves[0], loop=group, body=tuple(body))]
        operations += body
    return tuple(operations)


def sampling_positions(system: System) -> Mapping[int, int]:
    """Slave → position in `System.exchange_steps` at which all inputs are up to date that it samples in one call."""
    positions: dict[int, int] = {}
    in_loop: dict[int, int] = {}
    position = 0
    for each in system.exchange_order:
        for slave in each.slaves if isinstance(each, AlgebraicLoop) else [each]:
            positions[slave] = position
            if isinstance(each, AlgebraicLoop):
                in_loop[slave] = position
            position += 1
    # a slave in a loop samples there: the loop is solved with its output
    return positions | in_loop
