"""Transfer functions → state space, for any number of inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from flexfmu.cosim.errors import InputError
from flexfmu.cosim.slave import RealArray

Matrices = tuple[RealArray, RealArray, RealArray, RealArray]
"""A, B, C, D."""


def realise(numerators: Sequence[Sequence[RealArray]], denominators: Sequence[Sequence[RealArray]]) -> Matrices:
    """State space of a matrix of transfer functions, in s or z alike.

    Every element gets the states of its own controllable canonical form (T. Kailath, Linear Systems, 1980, section
    2.1.1), so that the realisation isn't minimal where elements share poles; the response is the same.

    Args:
        numerators, denominators: [output][input] → coefficients, highest power first.

    Raises:
        InputError: an element isn't proper.
    """
    height, width = len(numerators), len(numerators[0])
    D = np.zeros((height, width))
    parts: list[RealArray] = []
    rows: list[RealArray] = []
    columns: list[RealArray] = []
    for i in range(height):
        for j in range(width):
            a, c, D[i, j] = _canonical(numerators[i][j], denominators[i][j], f"[{i}, {j}]")
            parts.append(a)
            columns.append(np.outer(np.eye(len(a), 1), np.eye(1, width, j)))
            rows.append(np.outer(np.eye(1, height, i), c))
    return _stack(parts), np.concatenate(columns), np.concatenate(rows, axis=1), D


def _canonical(numerator: RealArray, denominator: RealArray, where: str) -> tuple[RealArray, RealArray, float]:
    """A, C, D of one element; B is the first unit vector."""
    b, a = (
        np.trim_zeros(np.asarray(numerator, dtype=float), "f"),
        np.trim_zeros(np.asarray(denominator, dtype=float), "f"),
    )
    if not (np.isfinite(b).all() and np.isfinite(a).all()):
        raise InputError(f"the coefficients of element {where} must be finite, got {numerator} / {denominator}")
    if a.size == 0:
        raise InputError(f"the denominator of element {where} is zero")
    if b.size > a.size:
        raise InputError(
            f"element {where} isn't proper: its numerator has degree {b.size - 1}, its denominator {a.size - 1}; "
            "add fast poles, such as a derivative filter"
        )
    b = np.concatenate([np.zeros(a.size - b.size), b]) / a[0]
    a = a / a[0]
    A = np.eye(a.size - 1, k=-1)
    A[:1] = -a[1:]
    return A, b[1:] - b[0] * a[1:], float(b[0])


def _stack(parts: Sequence[RealArray]) -> RealArray:
    """Block-diagonal matrix, parts without states left out."""
    full = [part for part in parts if part.size]
    return np.asarray(block_diag(*full), dtype=float) if full else np.zeros((0, 0))
