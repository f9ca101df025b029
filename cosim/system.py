"""Wiring: slaves and connections by name, checked, and sorted by direct feedthrough."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from graphlib import CycleError, TopologicalSorter

from flexfmu.cosim.errors import AlgebraicLoopError, WiringError
from flexfmu.cosim.slave import Causality, Slave, feedthrough


@dataclass(frozen=True)
class Connection:
    """An output that feeds an input; indices of slaves in `System.slaves` and of variables in `Slave.variables`."""

    source: int
    output: int
    target: int
    input: int


@dataclass(frozen=True)
class System:
    """Slaves wired together.

    Attributes:
        slaves: the slaves as given.
        connections: the connections as given, resolved.
        exchange_order: slaves in the order in which inputs are set and outputs read at one instant, so that every
            output is up to date when it is passed on; a slave may appear more than once.
        step_order: slaves in the order in which they are advanced over a step, sources before targets where possible.
        delayed: connections whose target is advanced before its source: over a step their input is extrapolated from
            the beginning of the step.
    """

    slaves: tuple[Slave, ...]
    connections: tuple[Connection, ...]
    exchange_order: tuple[int, ...]
    step_order: tuple[int, ...]
    delayed: tuple[Connection, ...]

    def describe(self, connection: Connection) -> str:
        """The connection as ``plant.y -> controller.u``."""
        source, target = self.slaves[connection.source], self.slaves[connection.target]
        output, receiver = source.variables[connection.output], target.variables[connection.input]
        return f"{source.name}.{output.name} -> {target.name}.{receiver.name}"


def connect(slaves: Sequence[Slave], connections: Iterable[tuple[str, str]]) -> System:
    """Wire slaves together.

    Args:
        slaves: slaves with different names.
        connections: pairs (``slave.output``, ``slave.input``).

    Raises:
        WiringError: a name is unknown or used twice, units differ, a direction is wrong, an input is connected twice.
        AlgebraicLoopError: outputs depend on each other at the same instant; the message names the loop.
    """
    _check_names(slaves)
    resolved = tuple(_resolve(slaves, source, target) for source, target in connections)
    _check_single_sources(slaves, resolved)
    exchange_order = _exchange_order(slaves, resolved)
    step_order = _step_order(slaves, resolved)
    position = {slave: rank for rank, slave in enumerate(step_order)}
    delayed = tuple(each for each in resolved if position[each.source] >= position[each.target])
    return System(tuple(slaves), resolved, exchange_order, step_order, delayed)


def _check_names(slaves: Sequence[Slave]) -> None:
    """Names of slaves are unique and hold no dot."""
    names = [slave.name for slave in slaves]
    for name in names:
        if names.count(name) > 1:
            raise WiringError(f"two slaves are named {name!r}; give each its own name")
        if not name or "." in name:
            raise WiringError(f"{name!r} can't name a slave: take a name without a dot")


def _resolve(slaves: Sequence[Slave], source: str, target: str) -> Connection:
    """Look up both ends of a connection."""
    from_slave, output = _find(slaves, source, "output")
    to_slave, receiver = _find(slaves, target, "input")
    units = slaves[from_slave].variables[output].unit, slaves[to_slave].variables[receiver].unit
    if all(units) and units[0] != units[1]:
        raise WiringError(f"units differ: {source} is in {units[0]}, {target} in {units[1]}; put a conversion between")
    return Connection(from_slave, output, to_slave, receiver)


def _find(slaves: Sequence[Slave], full_name: str, causality: Causality) -> tuple[int, int]:
    """Index of the slave and of the variable that ``slave.variable`` names."""
    slave_name, _, name = full_name.partition(".")
    index = {slave.name: i for i, slave in enumerate(slaves)}.get(slave_name)
    if index is None:
        known = ", ".join(slave.name for slave in slaves)
        raise WiringError(f"{full_name!r}: there is no slave {slave_name!r}; slaves: {known}")
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


def _check_single_sources(slaves: Sequence[Slave], connections: Sequence[Connection]) -> None:
    """An input has one source."""
    seen: set[tuple[int, int]] = set()
    for each in connections:
        if (each.target, each.input) in seen:
            slave = slaves[each.target]
            raise WiringError(f"{slave.name}.{slave.variables[each.input].name} is connected twice; keep one source")
        seen.add((each.target, each.input))


def _exchange_order(slaves: Sequence[Slave], connections: Sequence[Connection]) -> tuple[int, ...]:
    """Slaves by direct feedthrough between their variables; neighbours of one slave are one visit."""
    sorter = TopologicalSorter(_dependencies(slaves, connections))
    try:
        sorter.prepare()
    except CycleError as error:
        raise _loop(slaves, error.args[1]) from None
    order: list[int] = []
    ready = list(sorter.get_ready())
    while ready:
        if not order or all(slave != order[-1] for slave, _ in ready):
            order.append(min(slave for slave, _ in ready))
        visited = [node for node in ready if node[0] == order[-1]]
        sorter.done(*visited)
        ready = [node for node in ready if node not in visited] + list(sorter.get_ready())
    return tuple(order)


def _dependencies(
    slaves: Sequence[Slave], connections: Sequence[Connection]
) -> Mapping[tuple[int, str], Sequence[tuple[int, str]]]:
    """(slave, variable) → what it depends on at the same instant."""
    graph: dict[tuple[int, str], list[tuple[int, str]]] = {}
    for i, slave in enumerate(slaves):
        for output, inputs in feedthrough(slave).items():
            graph[i, output] = [(i, name) for name in inputs]
    for each in connections:
        target = each.target, slaves[each.target].variables[each.input].name
        graph.setdefault(target, []).append((each.source, slaves[each.source].variables[each.output].name))
    return graph


def _loop(slaves: Sequence[Slave], cycle: Sequence[tuple[int, str]]) -> AlgebraicLoopError:
    """The error that names the loop in the direction of the signals."""
    names = " -> ".join(f"{slaves[slave].name}.{name}" for slave, name in cycle)
    remedy = "put a slave with a state or a sample time into it, or declare what has no direct feedthrough"
    return AlgebraicLoopError(f"algebraic loop: {names}; {remedy}")


def _step_order(slaves: Sequence[Slave], connections: Sequence[Connection]) -> tuple[int, ...]:
    """Sources before targets; a loop is opened where the fewest feedthrough inputs, then inputs, are late."""
    remaining = list(range(len(slaves)))
    order: list[int] = []
    direct = {(i, name) for i, slave in enumerate(slaves) for names in feedthrough(slave).values() for name in names}

    def late(slave: int) -> tuple[int, int]:
        """Inputs of the slave whose source would be advanced after it: with direct feedthrough, and all."""
        inputs = [each for each in connections if each.target == slave and each.source in remaining]
        names = [slaves[slave].variables[each.input].name for each in inputs]
        return sum((slave, name) in direct for name in names), len(inputs)

    while remaining:
        order.append(min(remaining, key=late))
        remaining.remove(order[-1])
    return tuple(order)
