"""Small symbolic vectors and matrices that may be empty, where CasADi is particular about shapes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi
import numpy as np


def column(entries: Sequence[casadi.SX]) -> casadi.SX:
    return casadi.vertcat(casadi.SX(0, 1), *entries)


def symmetric(
    count: int, entry: Callable[[int, int], casadi.SX], pattern: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> casadi.SX:
    """A symmetric matrix with entries only where the pattern is not an exact zero; upper and lower share their symbols."""
    matrix = casadi.SX(count, count)
    for i in range(count):
        for j in range(i, count):
            if pattern[i, j]:
                matrix[i, j] = matrix[j, i] = entry(i, j)
    return matrix


def dot(left: casadi.SX, right: casadi.SX) -> casadi.SX:
    """left' right, zero for empty vectors."""
    return casadi.dot(left, right) if right.numel() else casadi.SX(0)


def form(matrix: casadi.SX, left: casadi.SX, right: casadi.SX) -> casadi.SX:
    """left' matrix right, zero for empty vectors."""
    return casadi.bilin(matrix, left, right) if left.numel() and right.numel() else casadi.SX(0)
