"""Builds a block from its equations: symbols, dense functions, and direct feedthrough from the Jacobian's sparsity."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.slave import check_variables
from flexfmu.cosim.engine.slave import check_sampling
from flexfmu.model.symbolic import SharedLibrary, SymbolicBlock, Variable

Vector = Any
"""A CasADi column vector, SX or MX."""

Equations = Callable[[Vector, Vector, Vector], tuple[Vector, Vector]]
"""(x, u, p) → (y, next x), all column vectors."""


def block(
    kind: str,
    description: str,
    equations: Equations,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "",
    instants: Sequence[float] = (),
    inputs: Sequence[Variable],
    outputs: Sequence[Variable],
    parameters: Sequence[Variable] = (),
    states: Sequence[float] = (),
    symbol: Any = casadi.SX,
    latency: Mapping[str, float] | None = None,
    c_files: Mapping[str, str] | None = None,
    libraries: Mapping[str, SharedLibrary] | None = None,
) -> SymbolicBlock:
    """Build a block from equations; an output has direct feedthrough from every input that it depends on structurally.

    Args:
        kind, description: of the block.
        equations: (x, u, p) → (y, next x); called once, with symbols.
        sample_time: time between samples [s].
        offset: first sample instant [s].
        name: of the block, by default that of its kind.
        instants: further sample instants [s]; with an infinite sample time there are no others.
        inputs, outputs, parameters: variables in the order of u, y and p.
        states: start values of x.
        symbol: `casadi.SX` for scalar operations; `casadi.MX` for operations on whole vectors.
        latency: output → delay at low frequency [s].
        c_files: C files and headers that the equations call as `casadi.external`, name → text.
        libraries: shared libraries that these call, name → library.

    Raises:
        InputError: the sample time or offset is out of range, two variables share a name, or a parameter is out of
            range.
    """
    name = name or kind
    if sample_time < math.inf or not instants:
        check_sampling(sample_time, offset, name)
    # CasADi functions of the equations
    arguments = [
        symbol.sym(letter, len(each)) for letter, each in zip("xup", (states, inputs, parameters), strict=True)
    ]
    y, following = (casadi.densify(each) for each in equations(*arguments))
    output = casadi.Function("output", arguments, [y], ["x", "u", "p"], ["y"])
    # direct feedthrough follows from the output function: the inputs that each output depends on
    sparsity = output.jac_sparsity(0, 1)
    pairs = list(zip(sparsity.row(), sparsity.get_col(), strict=True))
    result = SymbolicBlock(
        name=name,
        description=description,
        sample_time=sample_time,
        offset=offset,
        instants=tuple(instants),
        inputs=tuple(inputs),
        outputs=tuple(outputs),
        parameters=tuple(parameters),
        states=tuple(float(value) for value in states),
        output=output,
        update=casadi.Function("update", arguments, [following], ["x", "u", "p"], ["next_x"]),
        feedthrough={
            variable.name: tuple(inputs[column].name for row, column in pairs if row == i)
            for i, variable in enumerate(outputs)
        },
        latency=latency or {},
        c_files=c_files or {},
        libraries=libraries or {},
    )
    check_variables(result)
    return result


def split(vector: Vector, *sizes: int) -> list[Vector]:
    """Split a vector into pieces of these sizes; what remains is split into pieces of the last size.

    With a last size of zero nothing may remain. An empty vector has no pieces.
    """
    if not vector.numel():
        return []
    edges = list(accumulate(sizes, initial=0))
    if sizes[-1]:
        edges += range(edges[-1] + sizes[-1], vector.numel() + 1, sizes[-1])
    pieces: list[Vector] = casadi.vertsplit(vector, edges)
    return pieces


def rows_in_turn(rows: NDArray[np.float64], name: str) -> Equations:
    """Return equations that output the rows (N, n) of a table one after the other, in MX; the last one holds on.

    Their state, zero at first, counts the samples; the name is that of the table in C.
    """
    # a table that is read at its nodes; it needs one behind the last
    nodes = np.arange(len(rows) + 1.0)
    table = casadi.interpolant(name, "linear", [nodes], np.vstack([rows, rows[-1:]]).ravel())
    last = float(len(rows) - 1)
    return lambda x, u, p: (table(x), casadi.fmin(x + 1.0, last))
