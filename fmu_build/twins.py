"""C code of a function, in the runtime's type of number, which may hold a lane for each of several variants.

Twins, the operations that two equal parts of a model go through alike, are done at once.

The two legs of a robot take the same operations with other numbers; a register of two doubles does both at once, on every
processor of today. Starting from the twins among the arguments, operations with the same name on twin operands become twins
(superword-level parallelism: S. Larsen, S. Amarasinghe, PLDI 2000, https://doi.org/10.1145/349299.349320).

In the C code twins go side by side. Each part gets the bits that it would get alone: the operations are the same, in the same
order.
"""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
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

    def needed(self, results: Iterable[int]) -> set[int]:
        """The nodes that results need, themselves included."""
        needed = set(results)
        for node in reversed(range(len(self.nodes))):
            if node in needed:
                needed.update(self.operands(node))
        return needed

    def is_leaf(self, node: int) -> bool:
        """Whether a node is a constant or an argument."""
        return self.nodes[node][0] in LEAVES


def find_twins(
    graph: Graph, seeds: Iterable[tuple[Entry, Entry]], apart: Set[int] = frozenset()
) -> dict[int, tuple[int, int]]:
    """Twins among the nodes of a graph: node → (node of the first part, node of the second), for both.

    Args:
        graph: the graph.
        seeds: twins among the arguments.
        apart: operations that only become twins of each other.
    """
    pairing = _Pairing(graph, apart)
    numbers = {node: k for k, node in enumerate(graph.nodes) if node[0] == "INPUT"}
    for first, second in seeds:
        nodes = numbers.get(("INPUT", *first)), numbers.get(("INPUT", *second))
        if nodes[0] is not None and nodes[1] is not None:
            pairing.join(nodes[0], nodes[1])

    # twins whose other operands are the same, then those whose other operands differ
    pairing.sweep(pairing.exact)
    while pairing.sweep(pairing.rough) + pairing.sweep(pairing.exact):
        pass
    return pairing.twins


class _Pairing:
    """Twins found so far.

    Only nodes of the same level, the longest way from the arguments, become twins, so that none needs the other.

    Attributes:
        twins: node → both parts.
        exact: what each node is as an operand: a part of certain twins, an even number from the size of the graph on for the first
            and the odd one behind it for the second, or a certain node that both share.
        rough: the same, or any leaf or any operation.
    """

    def __init__(self, graph: Graph, apart: Set[int]) -> None:
        self.twins: dict[int, tuple[int, int]] = {}
        self._single: list[tuple[int, tuple[str, int, bool], tuple[int, ...]]] = []  # operations that are no twins yet
        levels = list[int]()
        for k, (name, *operands) in enumerate(graph.nodes):
            # a change of sign, which only one of two parts may have, counts for nothing
            height = 0 if graph.is_leaf(k) else max((levels[i] for i in operands), default=0)
            levels.append(height if graph.is_leaf(k) or name == "NEG" else height + 1)
            if name in OPERATIONS:
                self._single.append((k, (name, levels[k], k in apart), tuple(operands)))
        self.exact = list(range(len(graph.nodes)))
        self.rough = [-1 - graph.is_leaf(k) for k in self.exact]
        self._base = 2 * len(graph.nodes)

    def join(self, first: int, second: int) -> None:
        """Make twins of two nodes."""
        for part, node in enumerate((first, second)):
            self.twins[node] = (first, second)
            self.exact[node] = self.rough[node] = self._base + 2 * first + part

    def sweep(self, tags: Sequence[int]) -> int:
        """Join the nodes whose operands mirror each other, as ``exact`` or ``rough`` has them; how many twins these are."""
        waiting: dict[Any, list[int]] = defaultdict(list)
        found, base = 0, self._base
        for k, kind, operands in self._single:
            own = [tags[i] for i in operands]
            if max(own) < base:
                continue
            mirrored = [tag ^ 1 if tag >= base else tag for tag in own]
            if kind[0] in COMMUTATIVE:
                own.sort()
                mirrored.sort()
            if own == mirrored:
                continue
            if others := waiting[kind, *mirrored]:
                # the first part is the one with the first part of the first twins among the operands
                is_second = next(tag & 1 for tag in own if tag >= base)
                self.join(*((others.pop(0), k) if is_second else (k, others.pop(0))))
                found += 1
            else:
                waiting[kind, *own].append(k)
        self._single = [each for each in self._single if each[0] not in self.twins]
        return found


OPERATIONS = {
    "ADD": ("{0}+{1}", "flex_twin_add({0},{1})"),
    "SUB": ("{0}-{1}", "flex_twin_sub({0},{1})"),
    "MUL": ("{0}*{1}", "flex_twin_mul({0},{1})"),
    "DIV": ("{0}/{1}", "flex_twin_div({0},{1})"),
    "NEG": ("-{0}", "flex_twin_neg({0})"),
    "TWICE": ("{0}+{0}", "flex_twin_add({0},{0})"),
    "SQ": ("{0}*{0}", "flex_twin_mul({0},{0})"),
    "INV": ("1./{0}", "flex_twin_div(flex_twin_all(flex_real(1.)),{0})"),
    "SQRT": ("sqrt({0})", "flex_twin_sqrt({0})"),
    "SIN": ("sin({0})", "flex_twin_sin({0})"),
    "COS": ("cos({0})", "flex_twin_cos({0})"),
    "FABS": ("fabs({0})", "flex_twin_fabs({0})"),
}
"""Operation → C code for one number, and for twins with the functions of twins.h."""

FUNCTIONS = {
    name: f"{name.lower()}({{0}})"
    for name in ("TAN", "ASIN", "ACOS", "ATAN", "EXP", "EXPM1", "SINH", "COSH", "TANH", "LOG", "LOG1P")
} | {"ATAN2": "atan2({0},{1})", "POW": "pow({0},{1})", "CONSTPOW": "pow({0},{1})", "HYPOT": "hypot({0},{1})"}
"""Further functions without branches, of one number each."""

Unit = tuple[int, ...]
"""Nodes that are computed at once: one, or twins."""


def function_code(function: casadi.Function, seeds: Iterable[tuple[Entry, Entry]]) -> str | None:
    """C code of a function with one dense result; None if it has another operation than those above: a branch, for example.

    Args:
        function: the function, expanded to scalar operations.
        seeds: twins among its arguments.
    """
    graph = Graph.of(function)
    if not _is_served(graph, OPERATIONS.keys() | FUNCTIONS.keys()):
        return None
    return _Writer(graph, find_twins(graph, seeds)).code(function.name())


def two_functions(
    function: casadi.Function, n_first: int, names: tuple[str, str], seeds: Iterable[tuple[Entry, Entry]]
) -> tuple[str, str, int] | None:
    """C code of two functions of the same arguments that share operations, and the size of their work array w.

    The second one relies on what the first one has left in w. None if an operation has no code here.

    Args:
        function: both results in one, expanded to scalar operations.
        n_first: how many of its results are those of the first function.
        names: C names.
        seeds: twins among the arguments.
    """
    graph = Graph.of(function)
    if not _is_served(graph, OPERATIONS.keys() | FUNCTIONS.keys()):
        return None
    # the first function must not need what only the second one's arguments give: no twins across both
    writer = _Writer(graph, find_twins(graph, seeds, graph.needed(graph.results[:n_first])))
    first, second = (_parts(writer.statements(*each)) for each in ((0, n_first), (n_first, len(graph.results))))
    codes, sizes = _handing_on([*first, *second])
    pairs = 2 * sizes["flex_twin"]
    arrays = {"flex_twin": "flex_twin *pairs=(flex_twin *)w;", "real": f"real *numbers=w+{pairs};"}
    texts = [
        f"{_HEAD}\n{_calling('int', name, PARAMETERS, each, arrays, ('return 0;',))}"
        for name, each in zip(names, (codes[: len(first)], codes[len(first) :]), strict=True)
    ]
    return texts[0], texts[1], pairs + sizes["real"]


def lanes_code(function: casadi.Function) -> str | None:
    """C code of the residual (y, v, a, u, d) → r at several points in parallel (SIMD lanes).

    Returns None if the function branches or calls a function without a counterpart in ``lanes_math.h``.
    """
    graph = Graph.of(function)
    if not _is_served(graph, OPERATIONS.keys()):
        return None

    def number(node: int) -> str:
        name, *rest = graph.nodes[node]
        if name == "CONST":
            return f"flex_all({float(rest[0])!r})"
        if name == "INPUT":
            argument, index = rest
            return f"flex_all(d[{index}])" if argument == 4 else f"flex_load({'yvau'[argument]} + 4 * {index})"
        return f"s{node}"

    lines = []
    for node, (name, *_) in enumerate(graph.nodes):
        if not graph.is_leaf(node):
            form = re.sub(r"^(?=[a-z])", "flex_lanes_", OPERATIONS[name][0])
            lines.append(f"flex_lanes s{node}={form.format(*map(number, graph.operands(node)))};")
    lines += [f"flex_store(r + 4 * {k}, {number(node)});" for k, node in enumerate(graph.results)]
    return _c_function("FLEX_WIDE void", f"{function.name()}_lanes", LANES_PARAMETERS, lines)


_HEAD = '#include <math.h>\n#include "elementary.h"\n#include "model_functions.h"\n#include "twins.h"\n'

PARAMETERS = "const real **arg, real **res, int *iw, real *w, int mem"
"""Parameters of generated functions, which are CasADi's."""

LANES_PARAMETERS = "const double *y, const double *v, const double *a, const double *u, const double *d, double *r"
"""Parameters of the residual in lanes."""

LONG, PART = 1500, 300
"""A function of more statements than the first is cut into parts of the second: the time of compilers grows faster than its length."""

_STORES = {"real": "numbers", "flex_twin": "pairs", "flex_lanes": "lanes"}
"""Type of a value → array that takes those which a later part needs."""

_DEFINED, _NAME = re.compile(r"(\w+) ([st]\d+(?:_\d+)?)="), re.compile(r"\b[st]\d+(?:_\d+)?\b")


def _text(head: str, lines: Iterable[str]) -> str:
    return "\n  ".join([f"{head} {{", *lines]) + "\n}\n"


def _parts(statements: Sequence[str]) -> list[Sequence[str]]:
    """The statements of a function, those of a long one cut into parts."""
    length = PART if len(statements) > LONG else max(len(statements), 1)
    return [statements[k : k + length] for k in range(0, len(statements), length)]


def _handing_on(parts: Sequence[Sequence[str]]) -> tuple[list[list[str]], Counter[str]]:
    """Parts that keep what later ones need in arrays, whose places are used again, and fetch it before its first use; with the sizes of
    the arrays."""
    # type and part of each value, and the last part that needs it
    types, first, last = dict[str, str](), dict[str, int](), dict[str, int]()
    for k, part in enumerate(parts):
        for line in part:
            if defined := _DEFINED.match(line):
                types[defined[2]], first[defined[2]] = defined[1], k
            last |= dict.fromkeys(_NAME.findall(line), k)
    places, sizes = dict[str, str](), Counter[str]()
    free: dict[str, list[str]] = {each: [] for each in _STORES}
    codes = []
    for k, part in enumerate(parts):
        code, known = list[str](), dict[str, None]()
        for line in part:
            for used in _NAME.findall(line):
                if first[used] < k and used not in known:
                    known[used] = None
                    code.append(f"{types[used]} {used}={places[used]};")
            code.append(line)
            if (defined := _DEFINED.match(line)) and last[defined[2]] > k:
                number_type, value = defined[1], defined[2]
                if not free[number_type]:
                    free[number_type].append(f"{_STORES[number_type]}[{sizes[number_type]}]")
                    sizes[number_type] += 1
                places[value] = free[number_type].pop()
                code.append(f"{places[value]}={value};")
        for value in known:
            if last[value] == k:
                free[types[value]].append(places[value])
        codes.append(code)
    return codes, sizes


def _calling(
    kind: str,
    name: str,
    parameters: str,
    codes: Sequence[Sequence[str]],
    arrays: Mapping[str, str],
    ending: Sequence[str],
) -> str:
    """The parts, and the function that calls one after the other with arrays, type → declaration."""
    shared = ", ".join((parameters, *(f"{each} *restrict {_STORES[each]}" for each in arrays)))
    arguments = ", ".join(each.split()[-1].lstrip("*") for each in shared.split(","))
    helpers = [
        _text(f"static FLEX_APART {kind.replace('int', 'void')} {name}_{k}({shared})", code)
        for k, code in enumerate(codes)
    ]
    calls = [f"{name}_{k}({arguments});" for k in range(len(codes))]
    return "\n".join((*helpers, _text(f"{kind} {name}({parameters})", (*arrays.values(), *calls, *ending))))


def _c_function(kind: str, name: str, parameters: str, statements: Sequence[str], ending: Sequence[str] = ()) -> str:
    """C code of a function of straight code; what its parts hand on lies in arrays."""
    if len(statements) <= LONG:
        return _text(f"{kind} {name}({parameters})", (*statements, *ending))
    codes, sizes = _handing_on(_parts(statements))
    arrays = {each: f"{each} {_STORES[each]}[{size}];" for each, size in sizes.items()}
    return _calling(kind, name, parameters, codes, arrays, ending)


def _is_served(graph: Graph, operations: Set[str]) -> bool:
    """Whether there is code for all operations and constants."""
    return all(n[0] in operations or n[0] == "INPUT" or (n[0] == "CONST" and math.isfinite(n[1])) for n in graph.nodes)


class _Writer:
    """Writes the statements of a function, each before those that use it."""

    def __init__(self, graph: Graph, twins: dict[int, tuple[int, int]]) -> None:
        self._graph, self._twins = graph, twins
        self._lines: list[str] = []
        self._done: set[Unit] = set()
        self._packed: dict[tuple[int, int], str] = {}  # names of registers by the nodes that they hold
        self._taken: set[int] = set()  # parts of twins that have a name of their own

    def code(self, name: str) -> str:
        """The C code."""
        statements = self.statements(0, len(self._graph.results))
        return f"{_HEAD}\n{_c_function('int', name, PARAMETERS, statements, ('return 0;',))}"

    def statements(self, start: int, stop: int) -> Sequence[str]:
        """The statements that give these results, without those that have been written before."""
        results, zero, begin = self._graph.results[start:stop], ("CONST", 0.0), len(self._lines)
        zeros = [k for k, node in enumerate(results) if self._graph.nodes[node] == zero]
        if len(zeros) > LONG:
            self._lines.append(f"for (int i = 0; i < {len(results)}; i++) res[0][i]=flex_real(0.0);")
        written = set(zeros if len(zeros) > LONG else ())
        for k, node in enumerate(results):
            if k in written:
                continue
            for unit in self._needed(self._unit(node)):
                self._write(unit)
            self._lines.append(f"res[0][{k}]={self._number(node)};")
        return self._lines[begin:]

    def _unit(self, node: int) -> Unit:
        return self._twins.get(node, (node,))

    def _needed(self, unit: Unit) -> Iterator[Unit]:
        """The units that are still missing for a unit, and itself, in an order in which they can be computed."""
        stack = [(unit, False)]
        while stack:
            each, is_ready = stack.pop()
            if is_ready:
                yield each
            elif each not in self._done:
                self._done.add(each)
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
            form = FUNCTIONS.get(name) or OPERATIONS[name][0]
            self._lines.append(f"real s{first}={form.format(*operands)};")
            return
        registers = [self._register(*each) for each in self._operand_pairs(unit)]
        self._packed[unit[0], unit[1]] = f"t{first}"
        self._lines.append(f"flex_twin t{first}={OPERATIONS[name][1].format(*registers)};")

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
            return f"flex_real({float(rest[0])!r})"
        if name == "INPUT":
            return f"arg[{rest[0]}][{rest[1]}]"
        # a part of twins is taken out of its register once
        if node in self._twins and node not in self._taken:
            self._taken.add(node)
            first = self._twins[node][0]
            part = "first" if node == first else "second"
            self._lines.append(f"real s{node}=flex_twin_{part}(t{first});")
        return f"s{node}"
