"""What a block remembers from sample to sample, and what it takes for memory at its first one.

Start states are constants, but what came before the first sample may depend on parameters and inputs. So the first state
tells whether a sample has been taken, and up to then memory is whatever the equations say.
"""

from __future__ import annotations

from itertools import accumulate

import casadi

from flexfmu.cosim.blocks.equations import Vector


def empty(size: int) -> list[float]:
    """Start states of a memory of ``size`` numbers."""
    return [0.0] * (1 + size)


def repeated(values: Vector, times: int) -> Vector:
    """A vector (n,) several times, (times * n,); a row of copies is one operation in CasADi, a column isn't."""
    return casadi.vec(casadi.repmat(values, 1, times))


def cut(vector: Vector, *sizes: int) -> list[Vector]:
    """A column vector in pieces of these sizes, which may be zero; what remains is left out.

    A slice of a vector of length one that takes nothing would be an empty row, which counts when vectors are stacked.
    """
    edges = list(accumulate(sizes, initial=0))
    pieces: list[Vector] = casadi.vertsplit(vector, [*edges, vector.numel()])
    return pieces[: len(sizes)]


def recall(x: Vector, start: Vector) -> Vector:
    """The memory (size,), or ``start`` (size,) at the first sample."""
    return casadi.if_else(x[0], x[1:], start)


def remember(*values: Vector) -> Vector:
    """The states that hold some vectors until the next sample."""
    return casadi.vertcat(1.0, *values)
