"""How signals get from slave to slave: as which polynomial, known from when on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from flexfmu.cosim.engine.master.algorithms import Algorithm
from flexfmu.cosim.engine.master.dependencies import Connection, VariableKey, contracted, find_loops, order_of_calls
from flexfmu.cosim.engine.master.iteration import LoopSolver
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.slave import PredictsOutputs, Sampled, feedthrough, input_order, output_order


class Transport(Enum):
    """How signals get to an input; the value describes it in messages."""

    ANNOUNCED = "known in advance over the whole step"
    SAMPLED = "read at the sample instants"
    HELD_SAMPLE = "held between the samples of its source"
    INTERPOLATED = "interpolated between both ends of the step"
    AVERAGED = "held at the mean of both ends of the step"
    EXTRAPOLATED = "extrapolated from the beginning of the step"


@dataclass(frozen=True)
class Coupling:
    """How the signals of one slave reach another.

    Attributes:
        transport: which way.
        order: degree of the polynomial that is known at the beginning of a step.
        ends: derivatives at both ends of a step that an interpolating polynomial meets, of degree 2 ends + 1, or that
            are averaged; None where the source is advanced later than the target, or announces its outputs.
        exact: whether the input arrives at the output's value at the end of a step.
    """

    transport: Transport
    order: int
    ends: int | None
    exact: bool


Couplings = Mapping[tuple[int, int], Coupling]
"""(source, target) → how its signals get there."""


def couplings(system: System, algorithm: Algorithm) -> Couplings:
    """(source, target) → how its signals get there."""
    position = {slave: i for i, slave in enumerate(step_order(system, algorithm))}
    pairs = {(each.source, each.target) for each in system.connections}
    return {(a, b): _coupling(system, a, b, position.get(a, -1) < position.get(b, -1), algorithm) for a, b in pairs}


def _coupling(system: System, source: int, target: int, ahead: bool, algorithm: Algorithm) -> Coupling:
    """The best that source and target can do together."""
    giver, taker = system.slaves[source], system.slaves[target]
    used = [each.output for each in system.connections if (each.source, each.target) == (source, target)]
    accepted, known = input_order(taker), output_order(giver, used)
    # signals that are sampled, at either end
    if isinstance(giver, Sampled):
        return Coupling(Transport.HELD_SAMPLE, 0, None, exact=True)
    if isinstance(taker, Sampled):
        return Coupling(Transport.SAMPLED, 0, None, exact=False)
    if isinstance(giver, PredictsOutputs):
        order = min(giver.announced_order, accepted)
        exact = giver.ends_exactly and order == giver.announced_order
        return Coupling(Transport.ANNOUNCED if exact else Transport.EXTRAPOLATED, order, None, exact)
    # stepped slaves: as the algorithm says, as far as the target takes derivatives
    interpolates = algorithm.interpolates(ahead)
    if interpolates and accepted:
        return Coupling(Transport.INTERPOLATED, min(known, accepted), min(known, (accepted - 1) // 2), exact=True)
    if interpolates and algorithm.solver is not None:
        return Coupling(Transport.AVERAGED, 0, 0, exact=False)
    return Coupling(Transport.EXTRAPOLATED, min(known, accepted), None, exact=False)


def stale_after_step(system: System, coupled: Couplings) -> frozenset[int]:
    """Slaves whose outputs are out of date after a step until the next exchange: a directly fed-through input has not
    arrived at its source's value, or that source is out of date itself."""
    direct = {(i, n) for i, slave in enumerate(system.slaves) for names in feedthrough(slave).values() for n in names}
    through = [e for e in system.connections if (e.target, system.slaves[e.target].variables[e.input].name) in direct]
    # late by themselves, then by their sources
    stale = {each.target for each in through if not coupled[each.source, each.target].exact}
    for _ in system.slaves:
        stale |= {each.target for each in through if each.source in stale}
    return frozenset(stale)


def loop_order(system: System, coupled: Couplings) -> int:
    """Highest derivative that goes round a closed loop; 0 where there is none."""
    return max((coupled[each.source, each.target].order for each in system.delayed), default=0)


@dataclass(frozen=True)
class StepGroup:
    """Slaves that are advanced together.

    Attributes:
        slaves: in the order in which they are advanced.
        torn: connections within the group whose target is advanced before its source; none for a slave that is
            advanced once.
        solver: how the signals at the end of the step are found; None for a slave that is advanced once.
    """

    slaves: tuple[int, ...]
    torn: tuple[Connection, ...] = ()
    solver: LoopSolver | None = None


def step_groups(system: System, algorithm: Algorithm) -> tuple[StepGroup, ...]:
    """All slaves that are stepped, in order; those that feed each other are one group where the step is iterated."""
    stepped, signals = _stepped(system)
    if algorithm.solver is None:
        return tuple(StepGroup((i,)) for i in stepped)
    return tuple(_group(each, stepped, signals, algorithm.solver) for each in _ordered_rings(stepped, signals))


def step_order(system: System, algorithm: Algorithm) -> tuple[int, ...]:
    """All slaves that are stepped, in order."""
    return tuple(i for group in step_groups(system, algorithm) for i in group.slaves)


def feedback_signals(system: System, sampled: bool = False) -> list[Connection]:
    """Connections by which slaves that are stepped feed each other, or themselves; on demand those that sample, too."""
    stepped, signals = (system.step_order, system.connections) if sampled else _stepped(system)
    ring = {i: number for number, ring in enumerate(_ordered_rings(stepped, signals)) for i in ring}
    return [each for each in signals if ring[each.source] == ring[each.target]]


def _stepped(system: System) -> tuple[list[int], list[Connection]]:
    """Slaves that are stepped, in order, and the connections between them."""
    stepped = [i for i in system.step_order if not isinstance(system.slaves[i], Sampled)]
    return stepped, [each for each in system.connections if {each.source, each.target} <= set(stepped)]


def _ordered_rings(stepped: Sequence[int], signals: Sequence[Connection]) -> list[set[int]]:
    """Slaves that feed each other, and single ones, sources before targets."""
    # a graph of whole slaves, and its loops
    graph: dict[VariableKey, set[VariableKey]] = {(i, ""): set() for i in stepped}
    for each in signals:
        graph[each.target, ""].add((each.source, ""))
    rings = find_loops(graph)
    # each loop takes the place of its first slave
    owner = {(i, ""): position for position, i in enumerate(stepped)}
    members = {position: {i} for position, i in enumerate(stepped)}
    for ring in rings:
        members[owner[min(ring)]] = {i for i, _ in ring}
    return [members[position] for position in order_of_calls(contracted(graph, rings), owner)]


def _group(members: set[int], stepped: Sequence[int], signals: Sequence[Connection], solver: LoopSolver) -> StepGroup:
    """The group of slaves that feed each other, or a single one."""
    order = tuple(i for i in stepped if i in members)
    # what a slave needs from one that is advanced after it, or from itself, must be assumed
    position = {slave: i for i, slave in enumerate(order)}
    inner = [each for each in signals if each.source in position and each.target in position]
    torn = tuple(each for each in inner if position[each.source] >= position[each.target])
    return StepGroup(order, torn, solver if torn else None)
