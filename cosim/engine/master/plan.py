"""The plan of a run: the order in which slaves are initialised, set, sampled, read and stepped.

A run alternates between steps and exchanges. A step takes all slaves to the next communication point. The exchange
there prepares the next step: slaves that predict their outputs announce them, signals are passed on in the order of
direct feedthrough while sampled slaves sample, and where signals jump, derivatives are passed round closed loops again.

The plan is data. `flexfmu.cosim.engine.master.schedule` binds each operation to a Python call;
`flexfmu.cosim.engine.master.compiled_loop` translates the same operations into instructions for the loop in C.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
from typing import NamedTuple

from flexfmu.cosim.engine.master.couplings import (
    Algorithm,
    Couplings,
    StepGroup,
    loop_order,
    stale_after_step,
    step_groups,
)
from flexfmu.cosim.engine.master.system import AlgebraicLoop, System
from flexfmu.cosim.engine.slave import PredictsOutputs, Sampled, SamplesInTwoPhases


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
