"""Coupling algorithms, the polynomial of each input over a step, and the order in which slaves are stepped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from flexfmu.cosim.engine.master.iteration import Anderson, LoopSolver, Tolerance
from flexfmu.cosim.engine.master.system import Connection, System, VariableKey, contracted, find_loops, order_of_calls
from flexfmu.cosim.engine.slave import PredictsOutputs, Sampled, feedthrough, input_order, output_order


@dataclass(frozen=True)
class Algorithm:
    """A coupling algorithm, as the master uses it.

    Attributes:
        interpolates: whether an input is interpolated between both ends of a step, else extrapolated from its beginning,
            if its source is stepped after the target, and if it is stepped before.
        solver: solves for the signals at the end of a step in closed loops of slaves; None if steps aren't iterated.
    """

    interpolates = False, True
    solver: LoopSolver | None = field(default=None, init=False)


@dataclass(frozen=True)
class GaussSeidel(Algorithm):
    """Steps one slave after the other, sources first.

    An input is interpolated if its source has been stepped already; the inputs that close a loop are extrapolated.
    """


@dataclass(frozen=True)
class Jacobi(Algorithm):
    """Steps all slaves with inputs extrapolated from the beginning of the step; their order doesn't matter."""

    interpolates = False, False


@dataclass(frozen=True)
class Implicit(Algorithm):
    """Iterates the step of slaves in a closed loop until the signals at its end agree; stiff couplings stay stable.

    Every input is interpolated. With k derivatives of the signals the order is 2k + 2. An input that takes no
    derivatives is held at the mean of both ends, which has order 2. The slaves in the loop must be able to save and
    restore their state.

    Args:
        solver: solves for the signals at the end of the step. Its tolerance should be larger than the error of the
            slaves' own integrators.
    """

    interpolates = True, True
    solver: LoopSolver = field(default_factory=lambda: Anderson(tolerance=Tolerance(relative=1e-8)))


class Transport(Enum):
    """How an input gets its signal over a step; the value is the phrase for messages."""

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
        transport: kind of polynomial or sample.
        order: degree of the polynomial that is known at the beginning of a step.
        ends: highest derivative that the interpolating polynomial, of degree 2 ends + 1, matches at both ends of a
            step; 0 for the mean of both ends; None if the input isn't interpolated.
        exact: whether the input equals the output at the end of a step.
    """

    transport: Transport
    order: int
    ends: int | None
    exact: bool


Couplings = Mapping[tuple[int, int], Coupling]
"""(source, target), both indices of slaves → their coupling."""


def couplings(system: System, algorithm: Algorithm) -> Couplings:
    """The coupling of every connected pair of slaves."""
    position = {slave: i for i, slave in enumerate(step_order(system, algorithm))}
    pairs = {(each.source, each.target) for each in system.connections}
    return {(a, b): _coupling(system, a, b, position.get(a, -1) < position.get(b, -1), algorithm) for a, b in pairs}


def _coupling(system: System, source: int, target: int, ahead: bool, algorithm: Algorithm) -> Coupling:
    """The coupling with the highest order that source, target and algorithm allow.

    Args:
        system: slaves and connections.
        source, target: indices of slaves.
        ahead: whether the source is stepped before the target.
        algorithm: how slaves are coupled over a step.
    """
    giver, taker = system.slaves[source], system.slaves[target]
    used = [each.output for each in system.connections if (each.source, each.target) == (source, target)]
    accepted, known = input_order(taker), output_order(giver, used)
    # sampled source or target, or a source that predicts its outputs
    if isinstance(giver, Sampled):
        return Coupling(Transport.HELD_SAMPLE, 0, None, exact=True)
    if isinstance(taker, Sampled):
        return Coupling(Transport.SAMPLED, 0, None, exact=False)
    if isinstance(giver, PredictsOutputs):
        order = min(giver.announced_order, accepted)
        exact = giver.ends_exactly and order == giver.announced_order
        return Coupling(Transport.ANNOUNCED if exact else Transport.EXTRAPOLATED, order, None, exact)
    # stepped slaves: as the algorithm says, with the derivatives that the source gives and the target takes
    interpolates = algorithm.interpolates[ahead]
    if interpolates and accepted:
        return Coupling(Transport.INTERPOLATED, min(known, accepted), min(known, (accepted - 1) // 2), exact=True)
    if interpolates and algorithm.solver is not None:
        return Coupling(Transport.AVERAGED, 0, 0, exact=False)
    return Coupling(Transport.EXTRAPOLATED, min(known, accepted), None, exact=False)


def stale_after_step(system: System, coupled: Couplings) -> frozenset[int]:
    """Slaves whose outputs are out of date between a step and the exchange at its end.

    An input with direct feedthrough differs from its source at the end of the step, or the source is out of date.
    """
    direct = {(i, n) for i, slave in enumerate(system.slaves) for names in feedthrough(slave).values() for n in names}
    through = [e for e in system.connections if (e.target, system.slaves[e.target].variables[e.input].name) in direct]
    # inexact inputs, then inputs whose source is out of date
    stale = {each.target for each in through if not coupled[each.source, each.target].exact}
    for _ in system.slaves:
        stale |= {each.target for each in through if each.source in stale}
    return frozenset(stale)


def loop_order(system: System, coupled: Couplings) -> int:
    """Highest derivative that is passed round a closed loop of slaves; 0 if there is no loop."""
    return max((coupled[each.source, each.target].order for each in system.delayed), default=0)


@dataclass(frozen=True)
class StepGroup:
    """Slaves whose step is iterated together, or a single slave that is stepped once.

    Attributes:
        slaves: in the order in which they are stepped.
        torn: connections within the group whose target is stepped before its source; empty if nothing is iterated.
        solver: solves for the signals at the end of the step; None if nothing is iterated.
    """

    slaves: tuple[int, ...]
    torn: tuple[Connection, ...] = ()
    solver: LoopSolver | None = None


def step_groups(system: System, algorithm: Algorithm) -> tuple[StepGroup, ...]:
    """All slaves that are stepped, in order; those of a closed loop are one group if the step is iterated."""
    stepped, signals = _stepped(system)
    if algorithm.solver is None:
        return tuple(StepGroup((i,)) for i in stepped)
    groups = []
    for members in _ordered_rings(stepped, signals):
        order = tuple(i for i in stepped if i in members)
        # tear the connections from slaves that are stepped later, or from the slave itself
        position = {slave: i for i, slave in enumerate(order)}
        inner = [each for each in signals if each.source in position and each.target in position]
        torn = tuple(each for each in inner if position[each.source] >= position[each.target])
        groups.append(StepGroup(order, torn, algorithm.solver if torn else None))
    return tuple(groups)


def step_order(system: System, algorithm: Algorithm) -> tuple[int, ...]:
    """Indices of all slaves that are stepped, in the order of `step_groups`."""
    return tuple(i for group in step_groups(system, algorithm) for i in group.slaves)


def feedback_signals(system: System, sampled: bool = False) -> list[Connection]:
    """Connections within closed loops of stepped slaves; with ``sampled``, within loops of all slaves."""
    stepped, signals = (system.step_order, system.connections) if sampled else _stepped(system)
    ring = {i: number for number, ring in enumerate(_ordered_rings(stepped, signals)) for i in ring}
    return [each for each in signals if ring[each.source] == ring[each.target]]


def _stepped(system: System) -> tuple[list[int], list[Connection]]:
    """Indices of the slaves that are stepped, in order, and the connections between them."""
    stepped = [i for i in system.step_order if not isinstance(system.slaves[i], Sampled)]
    return stepped, [each for each in system.connections if {each.source, each.target} <= set(stepped)]


def _ordered_rings(stepped: Sequence[int], signals: Sequence[Connection]) -> list[set[int]]:
    """Closed loops of slaves, and slaves outside loops as sets of one, sources before targets."""
    # graph of whole slaves, and its loops
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
