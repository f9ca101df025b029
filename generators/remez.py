"""Minimax polynomials by Remez' exchange algorithm, in as many digits as mpmath is set to.

A polynomial is best where its error takes its largest size with alternating signs at degree + 2 nodes (Chebyshev). Solve for such
a polynomial at given nodes, move the nodes to the extrema of its error, and repeat until the extrema are equal.

J.-M. Muller, Elementary Functions, 3rd edition, Birkhäuser 2016, section 3.6.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from mpmath import chop, cos, lu_solve, matrix, mpf, pi

Function = Callable[[mpf], mpf]

GRID = 60
"""Points between two neighbouring nodes among which the next extremum is looked for."""
FLAT = mpf("1e-3")
"""The extrema of a minimax error are equal to this share."""
MOST_EXCHANGES = 20


def minimax(function: Function, weight: Function, low: mpf, high: mpf, degree: int) -> tuple[list[mpf], mpf]:
    """The polynomial P of ``degree`` for which max |weight (P - function)| on [low, high] is least.

    Returns:
        Its coefficients, the lowest power first, and that maximum.

    Raises:
        ArithmeticError: the exchange doesn't settle.
    """
    count = degree + 2
    # the zeros of a Chebyshev polynomial are a good first guess
    nodes = [(low + high) / 2 - (high - low) / 2 * cos(pi * (2 * i + 1) / (2 * count)) for i in range(count)]
    for _ in range(MOST_EXCHANGES):
        coefficients = _levelled(function, weight, nodes)
        highest_first = coefficients[::-1]

        def error(x: mpf, highest_first: list[mpf] = highest_first) -> mpf:
            return weight(x) * (_horner(highest_first, x) - function(x))

        # exchange: the extrema become the nodes
        nodes = _extrema(error, low, high, nodes)
        sizes = [abs(error(x)) for x in nodes]
        if max(sizes) - min(sizes) <= FLAT * max(sizes):
            return [chop(c) for c in coefficients], max(sizes)
    raise ArithmeticError(f"no minimax polynomial of degree {degree} on [{low}, {high}] in {MOST_EXCHANGES} exchanges")


def _horner(highest_first: list[mpf], x: mpf) -> mpf:
    value = mpf(0)
    for coefficient in highest_first:
        value = value * x + coefficient
    return value


def _levelled(function: Function, weight: Function, nodes: list[mpf]) -> list[mpf]:
    """Coefficients for which the weighted error has one size and alternating signs at the nodes."""
    count = len(nodes)
    rows = [[x**k for k in range(count - 1)] + [(-1) ** i / weight(x)] for i, x in enumerate(nodes)]
    solution = lu_solve(matrix(rows), matrix([function(x) for x in nodes]))
    return [solution[k] for k in range(count - 1)]


def _extrema(error: Function, low: mpf, high: mpf, nodes: list[mpf]) -> list[mpf]:
    """Near each node the point where the error is largest in the node's own direction."""
    ends = [low, *((a + b) / 2 for a, b in pairwise(nodes)), high]
    found = []
    for node, left, right in zip(nodes, ends[:-1], ends[1:], strict=True):
        sign = 1 if error(node) > 0 else -1
        points = [left + (right - left) * i / GRID for i in range(GRID + 1)]
        found.append(max(points, key=lambda x: sign * error(x)))
    return found
