"""Connections, and what depends on what at one instant: the graph of variables, its loops, and an order of calls.

Nodes of the graph are inputs and outputs; an output depends on the inputs with direct feedthrough to it, an input on the
output that feeds it. Loops are strongly connected components; they are torn at the outputs that feed the most inputs (tearing:
H. Elmqvist and M. Otter, Proc. European Simulation Multiconference 1994, 326). What is left is sorted topologically.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

from flexfmu.cosim.engine.master.linear_map import IDENTITY, SignalMap
from flexfmu.cosim.engine.slave import RatesFollowInputs, Sampled, SamplesInTwoPhases, Slave, feedthrough

VariableKey = tuple[int, str]
"""Index of a slave and name of one of its variables."""

Graph = Mapping[VariableKey, Collection[VariableKey]]
"""Variable → those it depends on at the same instant."""


@dataclass(frozen=True)
class Connection:
    """An output that feeds an input; indices of slaves in `System.slaves` and of variables in `Slave.variables`.

    The input is the output under the map ``transformation``.
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
    """The graph of all variables, as far as it decides about the order of calls.

    A slave that samples in one call (inputs, then outputs) is called when all of its inputs are up to date, whatever
    feedthrough it declares. Where that alone would close a loop, it outputs what it knew one sample earlier. The same holds
    for a slave whose outputs' derivatives follow its inputs.
    """
    one_call = {i for i, slave in enumerate(slaves) if in_one_call(slave) or isinstance(slave, RatesFollowInputs)}
    # slaves in loops when outputs of all of these depend on all inputs
    closing = one_call & _in_loops(declared(slaves, connections, one_call))
    # slaves in loops by declared feedthrough alone: these loops are algebraic
    algebraic = _in_loops(declared(slaves, connections, one_call - closing))
    return declared(slaves, connections, one_call - (closing - algebraic))


def _in_loops(graph: Graph) -> set[int]:
    """Slaves with a part in a loop."""
    return {slave for loop in find_loops(graph) for slave, _ in loop}


def in_one_call(slave: Slave) -> bool:
    """Whether the slave samples in one call, with all of its inputs."""
    return isinstance(slave, Sampled) and not isinstance(slave, SamplesInTwoPhases)


def declared(slaves: Sequence[Slave], connections: Sequence[Connection], complete: Collection[int] = ()) -> Graph:
    """The graph as the slaves declare it, but for the ``complete`` ones, which depend on all of their inputs.

    Inputs that aren't connected are left out: they wait for nothing.
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
    """Variables of a cycle in the direction of the signals, the first again at the end; empty when there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def find_loops(graph: Graph) -> list[frozenset[VariableKey]]:
    """Sets of variables that depend on each other (the strongly connected components with a cycle).

    Cycles are contracted one after the other until none is left.
    """
    # contract one cycle; its members, themselves contracted cycles perhaps, become one node
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
    """The graph with a cycle made one node."""
    result: dict[VariableKey, set[VariableKey]] = {}
    for node, needed in graph.items():
        merged = {name if each in ring else each for each in needed}
        result.setdefault(name if node in ring else node, set()).update(merged)
    result[name].discard(name)
    return result


def restricted(graph: Graph, inside: Collection[VariableKey], cut: Collection[VariableKey] = ()) -> Graph:
    """The part of the graph within a set of variables, without the use of the outputs ``cut``."""
    return {
        node: [each for each in graph.get(node, ()) if each in inside and each not in cut] for node in sorted(inside)
    }


def tear(graph: Graph, outputs: Collection[VariableKey]) -> tuple[VariableKey, ...]:
    """Outputs that, when they are assumed, leave no loop: few, by taking those that feed the most inputs first."""
    torn: list[VariableKey] = []
    while ring := cycle(restricted(graph, graph.keys(), torn)):
        users = {each: sum(each in needed for needed in graph.values()) for each in ring if each in outputs}
        torn.append(max(users, key=lambda each: (users[each], each)))
    return tuple(torn)


def order_of_calls(
    graph: Graph, owner: Mapping[VariableKey, int], inputs: Collection[VariableKey] = ()
) -> tuple[int, ...]:
    """Owners of variables in an order of exchange steps in which everything is up to date when it is needed.

    A topological sort that takes as many variables of one owner at a time as it can: one exchange step. An owner has a step
    when it has outputs that others need, and once more in the end if some of its inputs were late. In a step the ``inputs``
    are set before outputs are read, so an input that its owner's own output feeds waits for the next step. The graph must
    have no loop (see `contracted`).
    """
    sorter: TopologicalSorter[VariableKey] = TopologicalSorter(graph)
    sorter.prepare()
    order: list[int] = []
    done: set[VariableKey] = set()
    read: set[VariableKey] = set()  # in the current step
    ready = list(sorter.get_ready())

    def reached() -> list[VariableKey]:
        """Variables that the current step can bring up to date too."""
        own = [node for node in ready if order and owner[node] == order[-1]]
        return [node for node in own if node not in inputs or read.isdisjoint(graph.get(node, ()))]

    while ready:
        # the current step is at its end: choose the next owner, one that others wait for if there is one
        if not reached():
            waiting = sorted({owner[node] for node in ready})
            order.append(next((each for each in waiting if _is_awaited(graph, owner, each, done)), waiting[0]))
            read.clear()
        # take all that this step brings up to date; more may become ready by it
        updated = reached()
        sorter.done(*updated)
        done.update(updated)
        read.update(updated)
        ready = [node for node in ready if node not in updated] + list(sorter.get_ready())
    return tuple(order)


def _is_awaited(graph: Graph, owner: Mapping[VariableKey, int], chosen: int, done: Collection[VariableKey]) -> bool:
    """Whether an exchange step of an owner would bring a variable up to date that others need."""
    # follow the step: variables whose needs are met, until there are no more
    reached = set(done)
    waiting = {node for node, its in owner.items() if its == chosen} - reached
    while found := {node for node in waiting if reached.issuperset(graph.get(node, ()))}:
        reached |= found
        waiting -= found
    updated = reached.difference(done)
    return any(owner[node] != chosen and updated.intersection(needed) for node, needed in graph.items())


def contracted(graph: Graph, groups: Iterable[Collection[VariableKey]]) -> Graph:
    """The graph with each group made one node, named after its smallest member."""
    for group in groups:
        graph = _contract(graph, set(group), min(group))
    return graph
