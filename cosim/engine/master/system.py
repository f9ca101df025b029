"""Wiring: slaves connected by name, with checks, the maps from outputs to inputs, and the order of calls by direct feedthrough.

The order follows from the graph of direct dependencies at one instant. Its nodes are inputs and outputs; an output depends on the
inputs with direct feedthrough to it, an input on the output that feeds it. Loops are strongly connected components; they are torn at
the outputs that feed the most inputs (tearing: H. Elmqvist and M. Otter, Proc. European Simulation Multiconference 1994, 326). The
remaining graph is sorted topologically.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from typing import overload

from flexfmu.cosim.engine.errors import AlgebraicLoopError, InputError, WiringError
from flexfmu.cosim.engine.master.iteration import LoopSolver
from flexfmu.cosim.engine.slave import TAKES, Causality, Sampled, SamplesInTwoPhases, Slave, can_save, feedthrough

VariableKey = tuple[int, str]
"""(index of a slave, name of one of its variables)."""

Graph = Mapping[VariableKey, Collection[VariableKey]]
"""Variable → the variables that it depends on at the same instant."""


@dataclass(frozen=True)
class LinearMap:
    """y = factor x + offset; time derivatives are multiplied by the factor alone."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        """The mapped value; the identity returns it bit for bit."""
        return value if self == IDENTITY else self.factor * value + self.offset

    @overload
    def then(self, other: LinearMap) -> LinearMap: ...
    @overload
    def then(self, other: TableMap) -> TableMap: ...
    def then(self, other: SignalMap) -> SignalMap:
        """The composition: this map first, then the other."""
        if isinstance(other, TableMap):
            return TableMap(other.pairs, self.then(other.before))
        if self == IDENTITY or other == IDENTITY:
            return other if self == IDENTITY else self
        return LinearMap(other.factor * self.factor, other.factor * self.offset + other.offset)


IDENTITY = LinearMap()
"""The identity."""


@dataclass(frozen=True)
class TableMap:
    """Maps integers, Booleans (0 and 1) or enumeration items to numbers, without interpolation.

    Attributes:
        pairs: integers and the numbers that they are mapped to.
        before: linear map that is applied first; its result is rounded and looked up.
    """

    pairs: tuple[tuple[int, float], ...]
    before: LinearMap = IDENTITY

    def __call__(self, value: float) -> float:
        """The table's number for the value.

        Raises:
            InputError: the table has no entry for it.
        """
        key = self.before(value)
        for source, target in self.pairs:
            # rounded as a Real that feeds an Integer
            if abs(source - key) <= 0.5:
                return target
        known = ", ".join(str(source) for source, _ in self.pairs)
        raise InputError(f"the table of a connection has nothing for {key:g}, only for {known}; complete it")

    def then(self, other: SignalMap) -> TableMap:
        """The composition: this map first, then the other; values that the other has no entry for are left out."""
        pairs = []
        for source, target in self.pairs:
            with suppress(InputError):
                pairs.append((source, other(target)))
        return TableMap(tuple(pairs), self.before)


SignalMap = LinearMap | TableMap


@dataclass(frozen=True)
class Connection:
    """An output that feeds an input: input = transformation(output).

    Attributes:
        source, target: indices of the slaves in `System.slaves`.
        output, input: indices of the variables in `Slave.variables`.
        transformation: map from output to input.
    """

    source: int
    output: int
    target: int
    input: int
    transformation: SignalMap = IDENTITY


def source_of(slaves: Sequence[Slave], connection: Connection) -> VariableKey:
    """The output that the connection starts from."""
    return connection.source, slaves[connection.source].variables[connection.output].name


def target_of(slaves: Sequence[Slave], connection: Connection) -> VariableKey:
    """The input that the connection leads to."""
    return connection.target, slaves[connection.target].variables[connection.input].name


def dependencies(slaves: Sequence[Slave], connections: Sequence[Connection]) -> Graph:
    """The graph of all variables that determines the order of calls.

    A slave that samples in one call, or whose output derivatives depend on its inputs (``rates_follow_inputs``), is called
    when all of its inputs are up to date, whatever feedthrough it declares. If only this rule closes a loop, the
    declared feedthrough counts instead: inputs without feedthrough may then be one sample old.
    """
    one_call = {
        i for i, slave in enumerate(slaves) if in_one_call(slave) or getattr(slave, "rates_follow_inputs", False)
    }
    # slaves in loops if all outputs of these slaves depended on all inputs
    closing = one_call & _in_loops(declared(slaves, connections, one_call))
    # slaves in loops with their declared feedthrough: these loops are algebraic
    algebraic = _in_loops(declared(slaves, connections, one_call - closing))
    return declared(slaves, connections, one_call - (closing - algebraic))


def _in_loops(graph: Graph) -> set[int]:
    """Slaves with a variable in a loop."""
    return {slave for loop in find_loops(graph) for slave, _ in loop}


def in_one_call(slave: Slave) -> bool:
    """Whether the slave samples in one call, `Sampled.sample`, and not in two phases."""
    return isinstance(slave, Sampled) and not isinstance(slave, SamplesInTwoPhases)


def declared(slaves: Sequence[Slave], connections: Sequence[Connection], complete: Collection[int] = ()) -> Graph:
    """The graph with the slaves' declared feedthrough; outputs of ``complete`` slaves depend on all of their inputs.

    Unconnected inputs are left out.
    """
    graph: dict[VariableKey, list[VariableKey]] = {}
    connected = {target_of(slaves, each) for each in connections}
    for i, slave in enumerate(slaves):
        # within a slave: outputs on inputs
        inputs = [variable.name for variable in slave.variables if variable.causality == "input"]
        for output, names in feedthrough(slave).items():
            needed = inputs if i in complete else names
            graph[i, output] = [(i, name) for name in needed if (i, name) in connected]
    # between slaves: inputs on outputs
    for each in connections:
        graph.setdefault(target_of(slaves, each), []).append(source_of(slaves, each))
    return graph


def cycle(graph: Graph) -> list[VariableKey]:
    """Variables of one cycle in the direction of the signals, the first repeated at the end; empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def find_loops(graph: Graph) -> list[frozenset[VariableKey]]:
    """Sets of variables that depend on each other (the strongly connected components with a cycle).

    Cycles are contracted one by one until none is left.
    """
    # contract one cycle to a node; its members may be contracted cycles themselves
    groups: dict[VariableKey, set[VariableKey]] = {}  # node of the contracted graph → variables that it stands for
    left = graph
    while ring := cycle(left):
        members: set[VariableKey] = set()
        for each in ring:
            members |= groups.pop(each, {each})
        groups[ring[0]] = members
        left = _contract(left, set(ring), ring[0])
    return sorted(map(frozenset, groups.values()), key=min)


def _contract(graph: Graph, ring: set[VariableKey], name: VariableKey) -> Graph:
    """The graph with the nodes of ``ring`` merged into the node ``name``."""
    result: dict[VariableKey, set[VariableKey]] = {}
    for node, needed in graph.items():
        merged = {name if each in ring else each for each in needed}
        result.setdefault(name if node in ring else node, set()).update(merged)
    result[name].discard(name)
    return result


def restricted(graph: Graph, inside: Collection[VariableKey], cut: Collection[VariableKey] = ()) -> Graph:
    """The subgraph of the variables ``inside``, without dependencies on the outputs ``cut``."""
    return {
        node: [each for each in graph.get(node, ()) if each in inside and each not in cut] for node in sorted(inside)
    }


def tear(graph: Graph, outputs: Collection[VariableKey]) -> tuple[VariableKey, ...]:
    """Outputs that leave no loop when they are assumed.

    Those that feed the most inputs are taken first, so that they are few.
    """
    torn: list[VariableKey] = []
    while ring := cycle(restricted(graph, graph.keys(), torn)):
        users = {each: sum(each in needed for needed in graph.values()) for each in ring if each in outputs}
        torn.append(max(users, key=lambda each: (users[each], each)))
    return tuple(torn)


def order_of_calls(
    graph: Graph, owner: Mapping[VariableKey, int], inputs: Collection[VariableKey] = ()
) -> tuple[int, ...]:
    """The owner of each exchange step, in an order in which every variable is up to date when another depends on it.

    A topological sort that takes as many variables of one owner as possible at a time: one exchange step. An owner has
    a step when other owners depend on its outputs, and a last one if inputs remain. In a step the ``inputs`` are set
    before outputs are read, so that an input fed by its owner's own output waits for the next step.

    Args:
        graph: without loops (see `contracted`).
        owner: variable → number of the slave or loop that it belongs to.
        inputs: variables that are set, not read.
    """
    sorter: TopologicalSorter[VariableKey] = TopologicalSorter(graph)
    sorter.prepare()
    order: list[int] = []
    done: set[VariableKey] = set()
    read: set[VariableKey] = set()  # in the current step
    ready = list(sorter.get_ready())

    def reached() -> list[VariableKey]:
        """Variables that the current step can also bring up to date."""
        own = [node for node in ready if order and owner[node] == order[-1]]
        return [node for node in own if node not in inputs or read.isdisjoint(graph.get(node, ()))]

    while ready:
        # the current step is complete: choose the next owner, preferably one that others depend on
        if not reached():
            waiting = sorted({owner[node] for node in ready})
            order.append(next((each for each in waiting if _is_awaited(graph, owner, each, done)), waiting[0]))
            read.clear()
        # update all variables of this step; more may become ready
        updated = reached()
        sorter.done(*updated)
        done.update(updated)
        read.update(updated)
        ready = [node for node in ready if node not in updated] + list(sorter.get_ready())
    return tuple(order)


def _is_awaited(graph: Graph, owner: Mapping[VariableKey, int], chosen: int, done: Collection[VariableKey]) -> bool:
    """Whether an exchange step of the owner ``chosen`` would update a variable that other owners depend on."""
    # variables that the step would update: repeat until no more become ready
    reached = set(done)
    waiting = {node for node, its in owner.items() if its == chosen} - reached
    while found := {node for node in waiting if reached.issuperset(graph.get(node, ()))}:
        reached |= found
        waiting -= found
    updated = reached.difference(done)
    return any(owner[node] != chosen and updated.intersection(needed) for node, needed in graph.items())


def contracted(graph: Graph, groups: Iterable[Collection[VariableKey]]) -> Graph:
    """The graph with each group merged into its smallest variable."""
    for group in groups:
        graph = _contract(graph, set(group), min(group))
    return graph


@dataclass(frozen=True)
class AlgebraicLoop:
    """Outputs that depend on each other at the same instant.

    Attributes:
        name: the signals of the loop, for messages.
        slaves: indices of the slaves in the order of the exchange steps of a round; a slave may appear more than once.
        unknowns: (index of slave, index of variable) of the outputs that are assumed at the beginning of a round.
        solver: solves for the unknowns.
    """

    name: str
    slaves: tuple[int, ...]
    unknowns: tuple[tuple[int, int], ...]
    solver: LoopSolver


@dataclass(frozen=True)
class System:
    """Slaves wired together.

    Attributes:
        slaves: the slaves, in the order of the arguments of `connect`.
        connections: the connections in the same order, with indices instead of names.
        exchange_order: indices of slaves in the order in which inputs are set and outputs read at one instant, so that
            every output is up to date when it is passed on; a slave may appear more than once. Algebraic loops are
            solved in their place.
        step_order: indices of slaves in the order in which they are stepped, sources before targets where possible.
        delayed: connections whose target is stepped before its source: over a step their input is extrapolated from
            the beginning of the step, unless the step is iterated.
    """

    slaves: tuple[Slave, ...]
    connections: tuple[Connection, ...]
    exchange_order: tuple[int | AlgebraicLoop, ...]
    step_order: tuple[int, ...]
    delayed: tuple[Connection, ...]

    @property
    def exchange_steps(self) -> tuple[int, ...]:
        """The slave of each exchange step (inputs set, outputs read) at one instant, algebraic loops included."""
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
"""``slave.output``, the ``slave.input`` that it feeds, and optionally a map between them, which also converts units."""


def connect(slaves: Sequence[Slave], connections: Iterable[Wire], *, loops: LoopSolver | None = None) -> System:
    """Connect slaves to a system.

    Args:
        slaves: slaves with different names.
        connections: pairs (``slave.output``, ``slave.input``) with equal units and compatible types (see `TAKES`), or
            triples with a linear map or a table of integers.
        loops: solver for algebraic loops at every instant; None to refuse them.

    Returns:
        The slaves, the connections, and the orders of calls.

    Raises:
        WiringError: a name is unknown or used twice, units or types differ, a connection doesn't lead from an output to
            an input, an input is connected twice, or a sampled slave must be rolled back to solve a loop but can't.
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
    # order of calls: at one instant by direct feedthrough, over a step sources first
    exchange_order = _exchange_order(slaves, resolved, loops)
    step_order = _step_order(slaves, resolved)
    position = {slave: i for i, slave in enumerate(step_order)}
    delayed = tuple(each for each in resolved if position[each.source] >= position[each.target])
    return System(tuple(slaves), resolved, exchange_order, step_order, delayed)


def _resolve(slaves: Sequence[Slave], source: str, target: str, way: SignalMap | None = None) -> Connection:
    """The connection with indices instead of names; ``way`` is the map between its ends."""
    from_slave, output = _find(slaves, source, "output")
    to_slave, receiver = _find(slaves, target, "input")
    # compatible types
    ends = slaves[from_slave].variables[output], slaves[to_slave].variables[receiver]
    if ends[0].type not in TAKES[ends[1].type]:
        raise WiringError(
            f"types differ: {source} is {ends[0].type}, {target} {ends[1].type}, which takes {' and '.join(TAKES[ends[1].type])}; "
            f'put a conversion between, or declare the output of a Python slave SlaveVariable(.., type="{ends[1].type}")'
        )
    # equal units, unless a map converts them
    units = slaves[from_slave].variables[output].unit, slaves[to_slave].variables[receiver].unit
    if way is None and all(units) and units[0] != units[1]:
        raise WiringError(f"units differ: {source} is in {units[0]}, {target} in {units[1]}; put a conversion between")
    return Connection(from_slave, output, to_slave, receiver, way or IDENTITY)


def _find(slaves: Sequence[Slave], full_name: str, causality: Causality) -> tuple[int, int]:
    """Indices of the slave and of the variable for the name ``slave.variable``.

    Raises:
        WiringError: there is no such slave or variable, or the variable has another causality.
    """
    slave_name, _, name = full_name.partition(".")
    index = {slave.name: i for i, slave in enumerate(slaves)}.get(slave_name)
    if index is None:
        known = ", ".join(slave.name for slave in slaves)
        raise WiringError(f"{full_name!r}: there is no slave {slave_name!r}; slaves: {known}")
    # by name and causality; else report the mistake and suggest a name
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
    """Slaves and algebraic loops in the order of the exchange steps at one instant."""
    # graph of direct dependencies, and its loops
    graph = dependencies(slaves, connections)
    rings = find_loops(graph)
    if rings and solver is None:
        raise AlgebraicLoopError(
            f"algebraic loop: {_chain(slaves, cycle(declared(slaves, connections)))}; put a slave with a state or a sample time into "
            'it, declare what has no direct feedthrough, or solve it by iteration: cosimulation.loop_solver = "anderson" in a scene, '
            "connect(.., loops=Anderson()) in Python"
        )
    found = [_loop(slaves, connections, restricted(graph, ring), solver) for ring in rings if solver is not None]
    # each loop counts as one slave
    owner = {node: node[0] for node in {*graph, *chain.from_iterable(graph.values())}}
    owner |= {node: len(slaves) + i for i, ring in enumerate(rings) for node in ring}
    inputs = {target_of(slaves, each) for each in connections}
    order = order_of_calls(contracted(graph, rings), owner, inputs)
    steps = [found[i - len(slaves)] if i >= len(slaves) else i for i in order]
    # in a loop of sampled slaves a source may sample in one call after its target: the target's inputs are then set
    # again in a further exchange step, but if the target samples in one call itself, it sees them one sample later
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
    """The algebraic loop of the variables in the graph, torn and sorted.

    Raises:
        WiringError: a slave samples in one call but can't save and restore its state.
    """
    name = _chain(slaves, cycle(restricted(declared(slaves, connections), graph.keys())))
    # slaves that sample in one call must be rolled back before each round
    for i in sorted({slave for slave, _ in graph}):
        if in_one_call(slaves[i]) and not can_save(slaves[i]):
            remedy = "let it save and restore its state, or sample in two phases (output, update)"
            raise WiringError(f"{slaves[i].name} can't be repeated to solve the algebraic loop {name}; {remedy}")
    # outputs to assume, and the order of calls of a round
    torn = tear(graph, {source_of(slaves, each) for each in connections})
    inputs = {target_of(slaves, each) for each in connections}
    order = order_of_calls(restricted(graph, graph.keys(), torn), {node: node[0] for node in graph}, inputs)
    index = [{variable.name: k for k, variable in enumerate(slave.variables)} for slave in slaves]
    return AlgebraicLoop(name, order, tuple((slave, index[slave][variable]) for slave, variable in torn), solver)


def _full_name(slaves: Sequence[Slave], variable: VariableKey) -> str:
    """The name ``slave.variable``."""
    return f"{slaves[variable[0]].name}.{variable[1]}"


def _chain(slaves: Sequence[Slave], variables: Sequence[VariableKey]) -> str:
    """The names of the variables, joined by arrows."""
    return " -> ".join(_full_name(slaves, each) for each in variables)


def _step_order(slaves: Sequence[Slave], connections: Sequence[Connection]) -> tuple[int, ...]:
    """Slaves in the order in which they are stepped, sources before targets.

    An input is late if its source is stepped after it; outputs of sampled slaves, held over the step, are never late.
    The next slave is the one with the fewest late inputs with direct feedthrough, of equal ones with the fewest late
    inputs.
    """
    # inputs with direct feedthrough, and signals that change over a step
    remaining = list(range(len(slaves)))
    order: list[int] = []
    direct = {(i, name) for i, slave in enumerate(slaves) for names in feedthrough(slave).values() for name in names}
    stepped = [each for each in connections if not isinstance(slaves[each.source], Sampled)]

    def late(slave: int) -> tuple[int, int]:
        """Numbers of the slave's late inputs: those with direct feedthrough, and all."""
        inputs = [each for each in stepped if each.target == slave and each.source in remaining]
        names = [slaves[slave].variables[each.input].name for each in inputs]
        return sum((slave, name) in direct for name in names), len(inputs)

    # append the slave with the fewest late inputs, one after the other
    while remaining:
        order.append(min(remaining, key=late))
        remaining.remove(order[-1])
    return tuple(order)
