"""What a function of numbers or symbols returns, as one column."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector

SYMBOLS = (casadi.SX, casadi.MX)
"""Types of CasADi's symbols."""


def as_column(values: Any) -> Any:
    """Nested sequences, arrays, numbers and symbols as one column of symbols, or one array of floats."""
    if isinstance(values, np.ndarray) and values.dtype == float:
        return values.ravel()
    pieces = list(_pieces(values))
    if any(isinstance(each, SYMBOLS) for each in pieces):
        return casadi.vertcat(*pieces)
    return np.concatenate([np.ravel(np.asarray(each, dtype=float)) for each in pieces]) if pieces else np.zeros(0)


def _pieces(values: Any) -> Iterable[Any]:
    """The numbers, arrays of numbers and symbols in nested sequences."""
    if isinstance(values, SYMBOLS):
        yield casadi.vec(values)
    elif isinstance(values, (list, tuple)) or (isinstance(values, np.ndarray) and values.dtype == object):
        for each in np.ravel(values) if isinstance(values, np.ndarray) else values:
            yield from _pieces(each)
    else:
        yield values.full() if isinstance(values, casadi.DM) else values


def as_elements(column: Vector) -> Any:
    """The elements of a column of symbols as an array."""
    found = np.empty(column.numel(), dtype=object)
    found[:] = casadi.vertsplit(column)
    return found
