"""Wiring: slaves and connections by name, checked, and sorted by direct feedthrough."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import chain

from flexfmu.cosim.engine.errors import AlgebraicLoopError, WiringError
from flexfmu.cosim.engine.master.dependencies import (
    Connection,
    Graph,
    VariableKey,
    contracted,
    cycle,
    declared,
    dependencies,
    find_loops,
    in_one_call,
    order_of_calls,
    restricted,
    source_of,
    target_of,
    tear,
)
from flexfmu.cosim.engine.master.iteration import LoopSolver
from flexfmu.cosim.engine.master.linear_map import IDENTITY, SignalMap
from flexfmu.cosim.engine.slave import TAKES, Causality, Sampled, Slave, can_save, feedthrough


@dataclass(frozen=True)
class AlgebraicLoop:
    """Outputs that depend on each other at the same instant.

    Attributes:
        name: the signals on the way round.
        slaves: slaves in the order of the exchange steps of a round, each as often as needed.
        unknowns: outputs (slave, index of the variable) that are assumed at the beginning of a round.
        solver: how the loop is solved.
    """

    name: str
    slaves: tuple[int, ...]
    unknowns: tuple[tuple[int, int], ...]
    solver: LoopSolver


@dataclass(frozen=True)
class System:
    """Slaves wired together.

    Attributes:
        slaves: the slaves as given.
        connections: the connections as given, resolved.
        exchange_order: slaves in the order in which inputs are set and outputs read at one instant, so that every
            output is up to date when it is passed on; a slave may appear more than once. Loops are solved in their place.
        step_order: slaves in the order in which they are advanced over a step, sources before targets where possible.
        delayed: connections whose target is advanced before its source: over a step their input is extrapolated from
            the beginning of the step, unless the step is iterated.
    """

    slaves: tuple[Slave, ...]
    connections: tuple[Connection, ...]
    exchange_order: tuple[int | AlgebraicLoop, ...]
    step_order: tuple[int, ...]
    delayed: tuple[Connection, ...]

    @property
    def exchange_steps(self) -> tuple[int, ...]:
        """The slave of each exchange step (inputs are set, outputs read) at one instant, those on the way round loops too."""
        steps: list[int] = []
        for each in self.exchange_order:
            steps += each.slaves if isinstance(each, AlgebraicLoop) else [each]
        return tuple(steps)

    def source_name(self, connection: Connection) -> str:
        """The output that the connection starts from, as ``plant.y``."""
        return _full_name(self.slaves, source_of(self.slaves, connection))

    def describe(self, connection: Connection) -> str:
        """The connection as ``plant.y -> controller.u``."""
        return f"{self.source_name(connection)} -> {_full_name(self.slaves, target_of(self.slaves, connection))}"


Wire = tuple[str, str] | tuple[str, str, SignalMap]
"""``slave.output``, the ``slave.input`` that it feeds, and a map on the way, which answers for the units."""


def connect(slaves: Sequence[Slave], connections: Iterable[Wire], *, loops: LoopSolver | None = None) -> System:
    """Wire slaves together.

    Args:
        slaves: slaves with different names.
        connections: pairs (``slave.output``, ``slave.input``), in equal units and of types that suit each other (see
            `TAKES`), or triples with a linear map or a table of whole numbers.
        loops: how to solve algebraic loops, at every instant; None to refuse them.

    Raises:
        WiringError: a name is unknown or used twice, units or types differ, a direction is wrong, an input is connected twice,
            or a sampled slave would have to be repeated to solve a loop but can't.
        AlgebraicLoopError: outputs depend on each other at the same instant, and there is no solver; the message names
            the loop.
    """
    # names of slaves are unique and have no dot
    names = [slave.name for slave in slaves]
    for name in names:
        if names.count(name) > 1:
            raise WiringError(f"two slaves are named {name!r}; give each its own name")
        if not name or "." in name:
            raise WiringError(f"{name!r} can't name a slave: take a name without a dot")
    # an input has one source
    resolved = tuple(_resolve(slaves, *each) for each in connections)
    seen: set[tuple[int, int]] = set()
    for each in resolved:
        if (each.target, each.input) in seen:
            slave = slaves[each.target]
            raise WiringError(f"{slave.name}.{slave.variables[each.input].name} is connected twice; keep one source")
        seen.add((each.target, each.input))
    # orders of calls: at one instant by direct feedthrough, over a step sources first
    exchange_order = _exchange_order(slaves, resolved, loops)
    step_order = _step_order(slaves, resolved)
    position = {slave: i for i, slave in enumerate(step_order)}
    delayed = tuple(each for each in resolved if position[each.source] >= position[each.target])
    return System(tuple(slaves), resolved, exchange_order, step_order, delayed)


def _resolve(slaves: Sequence[Slave], source: str, target: str, way: SignalMap | None = None) -> Connection:
    """Look up both ends of a connection."""
    from_slave, output = _find(slaves, source, "output")
    to_slave, receiver = _find(slaves, target, "input")
    # types that suit each other
    ends = slaves[from_slave].variables[output], slaves[to_slave].variables[receiver]
    if ends[0].type not in TAKES[ends[1].type]:
        raise WiringError(
            f"types differ: {source} is {ends[0].type}, {target} {ends[1].type}, which takes {' and '.join(TAKES[ends[1].type])}; "
            f'put a conversion between, or declare the output of a Python slave SlaveVariable(.., type="{ends[1].type}")'
        )
    # equal units, unless a map on the way answers for them
    units = slaves[from_slave].variables[output].unit, slaves[to_slave].variables[receiver].unit
    if way is None and all(units) and units[0] != units[1]:
        raise WiringError(f"units differ: {source} is in {units[0]}, {target} in {units[1]}; put a conversion between")
    return Connection(from_slave, output, to_slave, receiver, way or IDENTITY)


def _find(slaves: Sequence[Slave], full_name: str, causality: Causality) -> tuple[int, int]:
    """Index of the slave and of the variable that ``slave.variable`` names."""
    slave_name, _, name = full_name.partition(".")
    index = {slave.name: i for i, slave in enumerate(slaves)}.get(slave_name)
    if index is None:
        known = ", ".join(slave.name for slave in slaves)
        raise WiringError(f"{full_name!r}: there is no slave {slave_name!r}; slaves: {known}")
    # by name and direction; else say what is wrong, and which name may have been meant
    variables = slaves[index].variables
    for i, variable in enumerate(variables):
        if variable.name == name and variable.causality == causality:
            return index, i
    if any(variable.name == name for variable in variables):
        raise WiringError(f"{full_name!r} is no {causality}; a connection leads from an output to an input")
    candidates = [variable.name for variable in variables if variable.causality == causality]
    hint = get_close_matches(name, candidates, n=1, cutoff=0.0)
    raise WiringError(
        f"{full_name!r}: no such {causality}" + (f"; did you mean {slave_name}.{hint[0]}?" if hint else "")
    )


def _exchange_order(
    slaves: Sequence[Slave], connections: Sequence[Connection], solver: LoopSolver | None
) -> tuple[int | AlgebraicLoop, ...]:
    """Slaves by direct feedthrough between their variables, and loops between them."""
    # what depends on what, and what goes round in it
    graph = dependencies(slaves, connections)
    rings = find_loops(graph)
    if rings and solver is None:
        raise _refusal(slaves, cycle(declared(slaves, connections)))
    found = [_loop(slaves, connections, restricted(graph, ring), solver) for ring in rings if solver is not None]
    # each loop counts as a slave of its own
    owner = {node: node[0] for node in {*graph, *chain.from_iterable(graph.values())}}
    owner |= {node: len(slaves) + i for i, ring in enumerate(rings) for node in ring}
    inputs = {target_of(slaves, each) for each in connections}
    order = order_of_calls(contracted(graph, rings), owner, inputs)
    steps = [found[i - len(slaves)] if i >= len(slaves) else i for i in order]
    # further exchange steps of slaves whose inputs come from one that samples, in one call, only after theirs: they close a
    # loop of sampled slaves, and those among them that sample in one call too see it one sample later
    last = {slave: i for i, slave in enumerate(order)}
    late = {
        each.target
        for each in connections
        if in_one_call(slaves[each.source])
        and not in_one_call(slaves[each.target])
        and last.get(each.target, -1) < last.get(each.source, -1)
    }
    return (*steps, *sorted(late))


def _loop(
    slaves: Sequence[Slave], connections: Sequence[Connection], graph: Graph, solver: LoopSolver
) -> AlgebraicLoop:
    """The loop of the variables in the graph, torn and sorted."""
    name = _chain(slaves, cycle(restricted(declared(slaves, connections), graph.keys())))
    # members that sample in one call are repeated from saved states
    for i in sorted({slave for slave, _ in graph}):
        if in_one_call(slaves[i]) and not can_save(slaves[i]):
            remedy = "let it save and restore its state, or sample in two phases (output, update)"
            raise WiringError(f"{slaves[i].name} can't be repeated to solve the algebraic loop {name}; {remedy}")
    # outputs to assume, and the order of calls from them round the loop
    torn = tear(graph, {source_of(slaves, each) for each in connections})
    inputs = {target_of(slaves, each) for each in connections}
    order = order_of_calls(restricted(graph, graph.keys(), torn), {node: node[0] for node in graph}, inputs)
    index = [{variable.name: k for k, variable in enumerate(slave.variables)} for slave in slaves]
    return AlgebraicLoop(name, order, tuple((slave, index[slave][variable]) for slave, variable in torn), solver)


def _full_name(slaves: Sequence[Slave], variable: VariableKey) -> str:
    """``slave.variable``."""
    return f"{slaves[variable[0]].name}.{variable[1]}"


def _chain(slaves: Sequence[Slave], variables: Sequence[VariableKey]) -> str:
    """Signals on their way."""
    return " -> ".join(_full_name(slaves, each) for each in variables)


def _refusal(slaves: Sequence[Slave], ring: Sequence[VariableKey]) -> AlgebraicLoopError:
    """The error that names the loop in the direction of the signals."""
    remedy = (
        "put a slave with a state or a sample time into it, declare what has no direct feedthrough, "
        'or solve it by iteration: cosimulation.loop_solver = "anderson" in a scene, connect(.., loops=Anderson()) in Python'
    )
    return AlgebraicLoopError(f"algebraic loop: {_chain(slaves, ring)}; {remedy}")


def _step_order(slaves: Sequence[Slave], connections: Sequence[Connection]) -> tuple[int, ...]:
    """Sources before targets; a loop is opened where the fewest feedthrough inputs, then inputs, are late.

    What is held between samples is never late.
    """
    # inputs with direct feedthrough, and signals that change over a step
    remaining = list(range(len(slaves)))
    order: list[int] = []
    direct = {(i, name) for i, slave in enumerate(slaves) for names in feedthrough(slave).values() for name in names}
    stepped = [each for each in connections if not isinstance(slaves[each.source], Sampled)]

    def late(slave: int) -> tuple[int, int]:
        """Inputs of the slave whose source would be advanced after it: with direct feedthrough, and all."""
        inputs = [each for each in stepped if each.target == slave and each.source in remaining]
        names = [slaves[slave].variables[each.input].name for each in inputs]
        return sum((slave, name) in direct for name in names), len(inputs)

    # one after the other the slave with the fewest late inputs
    while remaining:
        order.append(min(remaining, key=late))
        remaining.remove(order[-1])
    return tuple(order)
