"""C code of a function in which twins, equal operations of two parts of a model, go side by side (`flexfmu.fmu_build.twins`).

Each part gets the bits that it would get alone: the operations are the same, in the same order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import casadi

from flexfmu.fmu_build.twins import COMMUTATIVE, Entry, Graph, find_twins

_SCALAR = {
    "ADD": "{0}+{1}",
    "SUB": "{0}-{1}",
    "MUL": "{0}*{1}",
    "DIV": "{0}/{1}",
    "NEG": "-{0}",
    "TWICE": "{0}+{0}",
    "SQ": "{0}*{0}",
    "INV": "1./{0}",
    "SQRT": "sqrt({0})",
    "SIN": "sin({0})",
    "COS": "cos({0})",
    "FABS": "fabs({0})",
}
"""Operation → C code for one number."""

_TWIN = {
    "ADD": "flex_twin_add({0},{1})",
    "SUB": "flex_twin_sub({0},{1})",
    "MUL": "flex_twin_mul({0},{1})",
    "DIV": "flex_twin_div({0},{1})",
    "NEG": "flex_twin_neg({0})",
    "TWICE": "flex_twin_add({0},{0})",
    "SQ": "flex_twin_mul({0},{0})",
    "INV": "flex_twin_div(flex_twin_all(1.),{0})",
    "SQRT": "flex_twin_sqrt({0})",
    "SIN": "flex_twin_sin({0})",
    "COS": "flex_twin_cos({0})",
    "FABS": "flex_twin_fabs({0})",
}
"""The same for twins, with the functions of twins.h."""

Unit = tuple[int, ...]
"""Nodes that are computed at once: one, or twins."""


def twin_code(function: casadi.Function, seeds: Iterable[tuple[Entry, Entry]]) -> str | None:
    """C code of a function with one dense result; None if it has no twins or another operation than those above.

    Args:
        function: the function, expanded to scalar operations.
        seeds: twins among its arguments.
    """
    graph = Graph.of(function)
    writer = _Writer(graph, find_twins(graph, seeds))
    return writer.code(function.name()) if writer.is_served() else None


class _Writer:
    """Writes the statements of a function, each before those that use it."""

    def __init__(self, graph: Graph, twins: dict[int, tuple[int, int]]) -> None:
        self._graph, self._twins = graph, twins
        self._lines: list[str] = []
        self._packed: dict[tuple[int, int], str] = {}  # names of registers by the nodes that they hold
        self._taken: set[int] = set()  # parts of twins that have a name of their own

    def is_served(self) -> bool:
        """Whether there are twins, and code for all operations."""
        nodes = self._graph.nodes
        has_code = all(n[0] in _SCALAR or n[0] == "INPUT" or (n[0] == "CONST" and math.isfinite(n[1])) for n in nodes)
        return has_code and any(not self._graph.is_leaf(node) for node in self._twins)

    def code(self, name: str) -> str:
        """The C code."""
        results = self._graph.results
        done: set[Unit] = set()
        for k, node in enumerate(results):
            for unit in self._needed(self._unit(node), done):
                self._write(unit)
            self._lines.append(f"res[0][{k}]={self._number(node)};")
        body = "\n  ".join(self._lines)
        head = '#include <math.h>\n#include "elementary.h"\n#include "model_functions.h"\n#include "twins.h"\n'
        return f"{head}\nint {name}(const double **arg, double **res, int *iw, double *w, int mem) {{\n  {body}\n  return 0;\n}}\n"

    def _unit(self, node: int) -> Unit:
        return self._twins.get(node, (node,))

    def _needed(self, unit: Unit, done: set[Unit]) -> Iterator[Unit]:
        """The units that are still missing for a unit, and itself, in an order in which they can be computed."""
        stack = [(unit, False)]
        while stack:
            each, is_ready = stack.pop()
            if is_ready:
                yield each
            elif each not in done:
                done.add(each)
                stack.append((each, True))
                stack += (
                    (self._unit(i), False) for node in reversed(each) for i in reversed(self._graph.operands(node))
                )

    def _write(self, unit: Unit) -> None:
        first = unit[0]
        if self._graph.is_leaf(first):
            return
        name = self._graph.nodes[first][0]
        if len(unit) == 1:
            operands = [self._number(i) for i in self._graph.operands(first)]
            self._lines.append(f"double s{first}={_SCALAR[name].format(*operands)};")
            return
        registers = [self._register(*each) for each in self._operand_pairs(unit)]
        self._packed[unit[0], unit[1]] = f"t{first}"
        self._lines.append(f"flex_twin t{first}={_TWIN[name].format(*registers)};")

    def _operand_pairs(self, unit: Unit) -> list[tuple[int, int]]:
        """The operands of twins, side by side; factors and summands in the order that needs fewer moves."""
        first, second = (self._graph.operands(node) for node in unit)
        straight, crossed = list(zip(first, second, strict=True)), list(zip(first, reversed(second), strict=True))
        if self._graph.nodes[unit[0]][0] not in COMMUTATIVE:
            return straight
        return min(straight, crossed, key=lambda pairs: sum(map(self._moves, pairs)))

    def _moves(self, pair: tuple[int, int]) -> int:
        """Moves that bring two nodes side by side."""
        if self._twins.get(pair[0]) == pair:
            return 0
        return 1 if pair[0] == pair[1] or self._twins.get(pair[0]) == pair[::-1] else 2

    def _register(self, first: int, second: int) -> str:
        """Name of the register that holds two nodes side by side."""
        if (first, second) not in self._packed:
            self._packed[first, second] = name = f"t{first}_{second}"
            if first == second:
                value = f"flex_twin_all({self._number(first)})"
            elif (second, first) == self._twins.get(first) and not self._graph.is_leaf(first):
                value = f"flex_twin_turned(t{second})"
            else:
                value = f"flex_twin_of({self._number(first)},{self._number(second)})"
            self._lines.append(f"flex_twin {name}={value};")
        return self._packed[first, second]

    def _number(self, node: int) -> str:
        """C expression of one node."""
        name, *rest = self._graph.nodes[node]
        if name == "CONST":
            return repr(float(rest[0]))
        if name == "INPUT":
            return f"arg[{rest[0]}][{rest[1]}]"
        # a part of twins is taken out of its register once
        if node in self._twins and node not in self._taken:
            self._taken.add(node)
            first = self._twins[node][0]
            part = "first" if node == first else "second"
            self._lines.append(f"double s{node}=flex_twin_{part}(t{first});")
        return f"s{node}"
