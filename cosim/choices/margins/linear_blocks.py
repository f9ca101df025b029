"""Linearises what samples in a loop: blocks by exact derivatives of their equations at the operating point.

Rounding (quantisers, encoders), dead zones and backlash count as identity. Limits that aren't reached have no influence. Only states that inputs reach
count: those of random numbers have none. Functions in C have finite differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Slave
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.jets import RealArray

LARGE = 1e9
"""Change of an input, in its unit, for which dead zones and backlash don't matter."""

SAMPLES = 20
"""Samples after which the states of a block count as those of the operating point: memories are filled."""


@dataclass(frozen=True, eq=False)
class LinearBlock:
    """x_k+1 = A x_k + B u_k, y_k = C x_k + D u_k in deviations from the operating point, at instants offset + k sample_time."""

    a: RealArray
    b: RealArray
    c: RealArray
    d: RealArray
    sample_time: float
    offset: float


def linear_block(slave: Slave, inputs: RealArray) -> tuple[LinearBlock, RealArray]:
    """Linearise a sampled slave at constant inputs (m,).

    Returns:
        The block, and its outputs at the operating point (k,).

    Raises:
        InputError: the slave isn't a block, so that its equations aren't known.
    """
    if not isinstance(slave, BlockSlave):
        raise InputError(
            f"{slave.name} can't be linearised, as its equations aren't known: margins need controllers and imperfections of the "
            f"toolkit, python-control systems or own blocks"
        )
    block = slave.block
    states, parameters = np.array(block.states), [each.start or 0.0 for each in block.parameters]
    for _ in range(SAMPLES):
        states = np.asarray(block.update(states, inputs, parameters).full())[:, 0]
    a, b, c, d = (np.asarray(each.full()) for each in _jacobians(block)(states, inputs, parameters))
    if len(inputs) and not (b.any() or d.any()):
        # dead zones and backlash: the gain for large signals, which all pass
        a, b, c, d = (
            np.zeros((0, 0)),
            np.zeros((0, len(inputs))),
            np.zeros((len(block.outputs), 0)),
            _gain(block, inputs),
        )
    # what inputs don't reach, and what doesn't reach outputs, isn't part of a loop
    reached = sorted({*_reached(a, b)} & {*_reached(a.T, c.T)})
    outputs = np.asarray(block.output(states, inputs, parameters).full())[:, 0]
    linear = LinearBlock(a[np.ix_(reached, reached)], b[reached], c[:, reached], d, block.sample_time, block.offset)
    for matrix in (linear.a, linear.b, linear.c, linear.d):
        if not np.isfinite(matrix).all():
            raise InputError(f"{slave.name} has no finite derivatives at its operating point")
    return linear, outputs


def _gain(block: SymbolicBlock, inputs: RealArray) -> RealArray:
    """Gain of a block's first sample for large changes of each input."""
    states, parameters = block.states, [each.start or 0.0 for each in block.parameters]
    found = []
    for direction in np.eye(len(inputs)):
        far, near = (
            block.output(states, inputs + sign * LARGE * direction, parameters).full()[:, 0] for sign in (1, -1)
        )
        found.append((far - near) / (2.0 * LARGE))
    return np.array(found).T


def _jacobians(block: SymbolicBlock) -> casadi.Function:
    """(x, u, p) → A, B, C, D."""
    sizes = (len(block.states), len(block.inputs), len(block.parameters))
    scalar = [found for each in (block.update, block.output) if (found := _scalar(each)) is not None]
    is_scalar = len(scalar) == 2
    symbol: Any = casadi.SX if is_scalar else casadi.MX
    x, u, p = (symbol.sym(name, size) for name, size in zip("xup", sizes, strict=True))
    if is_scalar:
        following, output = (_without_rounding(each, [x, u, p]) for each in scalar)
    else:
        following, output = (each.call([x, u, p])[0] for each in (block.update, block.output))
    pairs = ((following, x), (following, u), (output, x), (output, u))
    return casadi.Function("jacobians", [x, u, p], [casadi.densify(casadi.jacobian(y, z)) for y, z in pairs])


def _scalar(function: casadi.Function) -> casadi.Function | None:
    """The function of scalar operations; None if it calls others, as one in C or a table, which have derivatives of their own."""
    if function.class_name() != "SXFunction":
        try:
            function = function.expand()
        except RuntimeError:
            return None
    kinds = {function.instruction_id(k) for k in range(function.n_instructions())}
    return None if casadi.OP_CALL in kinds else function


def _without_rounding(function: casadi.Function, arguments: list[Any]) -> Any:
    """The result of a function of scalar operations for symbols, with the identity for each rounding."""
    work: list[Any] = [casadi.SX(0)] * function.sz_w()
    result = casadi.SX.zeros(function.numel_out(0))
    for k in range(function.n_instructions()):
        kind, taken, given = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if kind == casadi.OP_INPUT:
            work[given[0]] = arguments[taken[0]][taken[1]]
        elif kind == casadi.OP_CONST:
            work[given[0]] = casadi.SX(function.instruction_constant(k))
        elif kind == casadi.OP_OUTPUT:
            result[given[1]] = work[taken[0]]
        elif kind in (casadi.OP_FLOOR, casadi.OP_CEIL):
            work[given[0]] = work[taken[0]]
        elif len(taken) == 1:
            work[given[0]] = casadi.SX.unary(kind, work[taken[0]])
        else:
            work[given[0]] = casadi.SX.binary(kind, work[taken[0]], work[taken[1]])
    return result


def _reached(a: RealArray, b: RealArray) -> list[int]:
    """Indices of the states that inputs reach."""
    reached = np.any(b != 0.0, axis=1)
    for _ in range(len(a)):
        more = reached | np.any(a[:, reached] != 0.0, axis=1)
        if (more == reached).all():
            break
        reached = more
    return [int(i) for i in np.flatnonzero(reached)]
