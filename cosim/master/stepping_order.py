"""In which order slaves are advanced over a step, and which of them repeat it together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flexfmu.cosim.master.algorithms import Algorithm
from flexfmu.cosim.master.dependencies import Connection, Variable, contracted, find_loops, visiting_order
from flexfmu.cosim.master.iteration import LoopSolver
from flexfmu.cosim.master.system import System
from flexfmu.cosim.slave import Sampled


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
    graph: dict[Variable, set[Variable]] = {(i, ""): set() for i in stepped}
    for each in signals:
        graph[each.target, ""].add((each.source, ""))
    rings = find_loops(graph)
    owner = {(i, ""): rank for rank, i in enumerate(stepped)}
    members = {rank: {i} for rank, i in enumerate(stepped)}
    for ring in rings:
        members[owner[min(ring)]] = {i for i, _ in ring}
    return [members[rank] for rank in visiting_order(contracted(graph, rings), owner)]


def _group(members: set[int], stepped: Sequence[int], signals: Sequence[Connection], solver: LoopSolver) -> StepGroup:
    """The group of slaves that feed each other, or a single one."""
    order = tuple(i for i in stepped if i in members)
    rank = {slave: i for i, slave in enumerate(order)}
    inner = [each for each in signals if each.source in rank and each.target in rank]
    torn = tuple(each for each in inner if rank[each.source] >= rank[each.target])
    return StepGroup(order, torn, solver if torn else None)
