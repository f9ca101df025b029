"""Shift registers in scalar equations: states that only move on are copied in runs instead of one statement each.

A delay line of thousands of samples, written as scalars, would be thousands of statements, on which a C compiler spends
minutes; as a run it is one loop.
"""

from __future__ import annotations

from itertools import pairwise

import casadi

SHORTEST_RUN = 16
"""Fewer states are cheaper as statements."""


def with_runs_copied(function: casadi.Function) -> casadi.Function:
    """The same function (x, u, p) → (y, next x) of scalars, with long runs next_x[i..j] = x[k..l] as copies.

    Where there are none the function itself is given back.
    """
    symbols = function.sx_in()
    y, next_x = function.call(symbols)
    runs = _runs(_sources(next_x, symbols[0]))
    if not runs:
        return function
    copied = {i for begin, _, length in runs for i in range(begin, begin + length)}
    rest = [i for i in range(next_x.numel()) if i not in copied]
    computed = casadi.Function(f"{function.name()}_computed", symbols, [y, next_x[rest]])
    arguments = [casadi.MX.sym(name, symbol.numel()) for name, symbol in zip("xup", symbols, strict=True)]
    outputs, states = computed.call(arguments)
    pieces = _pieces(runs, arguments[0], states, next_x.numel())
    names = function.name_in(), function.name_out()
    return casadi.Function(function.name(), arguments, [outputs, casadi.vertcat(*pieces)], *names)


def _sources(next_x: casadi.SX, x: casadi.SX) -> list[int]:
    """For each next state the index of the state that it is a copy of, or -1."""
    index = {x[j].element_hash(): j for j in range(x.numel())}
    entries = (next_x[i] for i in range(next_x.numel()))
    return [index.get(entry.element_hash(), -1) if entry.is_symbolic() else -1 for entry in entries]


def _runs(sources: list[int]) -> list[tuple[int, int, int]]:
    """Long runs of neighbours that copy neighbours: (first next state, first state, length)."""
    breaks = [i for i, (one, next_one) in enumerate(pairwise(sources), 1) if one < 0 or next_one != one + 1]
    bounds = [0, *breaks, len(sources)]
    candidates = ((begin, sources[begin], end - begin) for begin, end in pairwise(bounds) if end > begin)
    return [run for run in candidates if run[1] >= 0 and run[2] >= SHORTEST_RUN]


def _pieces(runs: list[tuple[int, int, int]], x: casadi.MX, computed: casadi.MX, total: int) -> list[casadi.MX]:
    """The next states in order: computed ones between copied runs."""
    pieces, at, used = [], 0, 0
    for begin, source, length in [*runs, (total, 0, 0)]:
        pieces += [computed[used : used + begin - at, 0], x[source : source + length, 0]]
        used, at = used + begin - at, begin + length
    return [piece for piece in pieces if piece.numel()]
