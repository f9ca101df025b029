"""Connections, and the graph of direct dependencies at one instant: its loops, and an order of calls.

Nodes of the graph are inputs and outputs; an output depends on the inputs with direct feedthrough to it, an input on
the output that feeds it. Loops are strongly connected components; they are torn at the outputs that feed the most
inputs (tearing: H. Elmqvist and M. Otter, Proc. European Simulation Multiconference 1994, 326). The remaining graph is
sorted topologically.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

from flexfmu.cosim.engine.master.linear_map import IDENTITY, SignalMap
from flexfmu.cosim.engine.slave import RatesFollowInputs, Sampled, SamplesInTwoPhases, Slave, feedthrough

VariableKey = tuple[int, str]
"""(index of a slave, name of one of its variables)."""

Graph = Mapping[VariableKey, Collection[VariableKey]]
"""Variable → the variables that it depends on at the same instant."""


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

    A slave that samples in one call, or whose output derivatives depend on its inputs (`RatesFollowInputs`), is called
    when all of its inputs are up to date, whatever feedthrough it declares. If only this rule closes a loop, the
    declared feedthrough counts instead: inputs without feedthrough may then be one sample old.
    """
    one_call = {i for i, slave in enumerate(slaves) if in_one_call(slave) or isinstance(slave, RatesFollowInputs)}
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
