"""Finds the operations of a function that two equal parts of a model, twins, go through alike.

The two legs of a robot take the same operations with other numbers; a register of two doubles does both at once, on every
processor of today. Starting from the twins among the arguments, operations with the same name on twin operands become twins
(superword-level parallelism: S. Larsen, S. Amarasinghe, PLDI 2000, https://doi.org/10.1145/349299.349320).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import casadi

LEAVES = ("CONST", "INPUT")
"""Names of nodes without operands."""

COMMUTATIVE = ("ADD", "MUL")

Node = tuple[Any, ...]
"""("CONST", value), ("INPUT", argument, index), or the name of an operation and its operands."""

Entry = tuple[int, int]
"""Argument of a function and index in it."""

_NAMES = {getattr(casadi, name): name.removeprefix("OP_") for name in dir(casadi) if name.startswith("OP_")}


@dataclass(frozen=True)
class Graph:
    """The scalar operations of a function, each once.

    Attributes:
        nodes: the operations, each after its operands.
        results: node of each entry of the result.
    """

    nodes: tuple[Node, ...]
    results: tuple[int, ...]

    @classmethod
    def of(cls, function: casadi.Function) -> Graph:
        """The operations of an expanded function with one dense result."""
        numbers: dict[Node, int] = {}
        work, results = [0] * function.sz_w(), [0] * function.nnz_out(0)
        for k in range(function.n_instructions()):
            name = _NAMES[function.instruction_id(k)]
            sources, targets = function.instruction_input(k), function.instruction_output(k)
            if name == "OUTPUT":
                results[targets[1]] = work[sources[0]]
                continue
            operands = sources if name == "INPUT" else [work[i] for i in sources]
            node = (name, function.instruction_constant(k)) if name == "CONST" else (name, *operands)
            work[targets[0]] = numbers.setdefault(node, len(numbers))
        return cls(tuple(numbers), tuple(results))

    def operands(self, node: int) -> tuple[int, ...]:
        """The nodes that a node works on."""
        return () if self.is_leaf(node) else self.nodes[node][1:]

    def is_leaf(self, node: int) -> bool:
        """Whether a node is a constant or an argument."""
        return self.nodes[node][0] in LEAVES


def find_twins(graph: Graph, seeds: Iterable[tuple[Entry, Entry]]) -> dict[int, tuple[int, int]]:
    """Twins among the nodes of a graph: node → (node of the first part, node of the second), for both.

    Args:
        graph: the graph.
        seeds: twins among the arguments.
    """
    pairing = _Pairing(graph)
    numbers = {node: k for k, node in enumerate(graph.nodes)}
    for first, second in seeds:
        nodes = numbers.get(("INPUT", *first)), numbers.get(("INPUT", *second))
        if nodes[0] is not None and nodes[1] is not None:
            pairing.join(nodes[0], nodes[1])

    # twins whose other operands are the same, then those whose other operands differ
    pairing.sweep(pairing.exact_tag)
    while pairing.sweep(pairing.rough_tag) + pairing.sweep(pairing.exact_tag):
        pass
    return pairing.twins


_Tag = Callable[[int, bool], tuple[Any, ...]]


class _Pairing:
    """Twins found so far.

    Only nodes of the same level, the longest way from the arguments, become twins, so that none needs the other.
    """

    def __init__(self, graph: Graph) -> None:
        self.twins: dict[int, tuple[int, int]] = {}
        self._graph = graph
        self._levels: list[int] = []
        for k, node in enumerate(graph.nodes):
            # a change of sign, which only one of two parts may have, counts for nothing
            height = max((self._levels[i] for i in graph.operands(k)), default=0)
            self._levels.append(height if graph.is_leaf(k) or node[0] == "NEG" else height + 1)
        self._operations = [k for k in range(len(graph.nodes)) if not graph.is_leaf(k)]

    def join(self, first: int, second: int) -> None:
        """Make twins of two nodes."""
        self.twins[first] = self.twins[second] = (first, second)

    def exact_tag(self, node: int, is_mirrored: bool) -> tuple[Any, ...]:
        """What an operand is: a part of certain twins, or a certain node that both share."""
        if node not in self.twins:
            return ("node", node, 0)
        twins = self.twins[node]
        return ("twins", twins[0], (node == twins[1]) ^ is_mirrored)

    def rough_tag(self, node: int, is_mirrored: bool) -> tuple[Any, ...]:
        """What an operand is: a part of certain twins, any leaf or any operation."""
        return self.exact_tag(node, is_mirrored) if node in self.twins else ("node", -1 - self._graph.is_leaf(node), 0)

    def sweep(self, tag: _Tag) -> int:
        """Join the nodes whose operands mirror each other; how many twins these are."""
        waiting: dict[Any, list[int]] = defaultdict(list)
        found = 0
        for k in self._operations:
            # without twins among the operands, both keys are the same
            if k in self.twins or self.twins.keys().isdisjoint(self._graph.nodes[k][1:]):
                continue
            key, mirrored = self._key(k, tag, False), self._key(k, tag, True)
            if key == mirrored:
                continue
            if others := waiting[mirrored]:
                # the first part is the one with the first part of the first twins among the operands
                is_second = next(part for kind, _, part in key[2] if kind == "twins")
                self.join(*((others.pop(0), k) if is_second else (k, others.pop(0))))
                found += 1
            else:
                waiting[key].append(k)
        return found

    def _key(self, node: int, tag: _Tag, is_mirrored: bool) -> tuple[Any, ...]:
        name, *operands = self._graph.nodes[node]
        tags = [tag(i, is_mirrored) for i in operands]
        return name, self._levels[node], tuple(sorted(tags) if name in COMMUTATIVE else tags)
