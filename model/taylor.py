"""Taylor coefficients of expressions along a motion: fewer operations than differentiating twice.

Each operation gives the coefficients of its result from those of its operands, x = x0 + x1 t + x2 t^2 (A. Griewank,
A. Walther, Evaluating Derivatives, 2nd edition, SIAM 2008, chapter 13).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial

import casadi

Jet = tuple[casadi.SX, casadi.SX, casadi.SX]
"""Taylor coefficients x0, x1, x2 of a scalar; structural zeros for what is zero."""

_ZERO = casadi.SX(1, 1)
_NOTHING: Jet = (_ZERO, _ZERO, _ZERO)


def taylor_coefficients(
    arguments: Sequence[tuple[casadi.SX, Sequence[casadi.SX]]], expression: casadi.SX
) -> tuple[casadi.SX, casadi.SX]:
    """The coefficients x1 and x2 of a column vector.

    Args:
        arguments: column vectors of symbols, each with its coefficients x1 and x2; what is left out is zero.
        expression: expression of these symbols.
    """
    function = casadi.Function("f", [symbols for symbols, _ in arguments], [casadi.densify(expression)])
    jets = [[_jet(symbols, rates, i) for i in range(symbols.numel())] for symbols, rates in arguments]
    work, results = [_NOTHING] * function.sz_w(), [_NOTHING] * function.nnz_out(0)
    # one instruction after the other
    for k in range(function.n_instructions()):
        name, sources, targets = (
            function.instruction_id(k),
            function.instruction_input(k),
            function.instruction_output(k),
        )
        if name == casadi.OP_OUTPUT:
            results[targets[1]] = work[sources[0]]
        elif name == casadi.OP_INPUT:
            work[targets[0]] = jets[sources[0]][sources[1]]
        elif name == casadi.OP_CONST:
            work[targets[0]] = (casadi.SX(function.instruction_constant(k)), _ZERO, _ZERO)
        else:
            operands = [coefficient for i in sources for coefficient in work[i]]
            given = (each.nnz() > 0 for each in operands)
            value, first, second = _recurrence(name, *given).call(operands)
            work[targets[0]] = value, first, second
    first, second = (casadi.vertcat(*(jet[order] for jet in results)) for order in (1, 2))
    return first, second


def _jet(symbols: casadi.SX, rates: Sequence[casadi.SX], i: int) -> Jet:
    first, second = (rates[k][i] if k < len(rates) else _ZERO for k in (0, 1))
    return symbols[i], first, second


def _divide(a: Jet, b: Jet) -> Jet:
    q0 = a[0] / b[0]
    if b[1].nnz() + b[2].nnz() == 0:
        return q0, a[1] / b[0], a[2] / b[0]
    inverse = 1 / b[0]
    q1 = (a[1] - q0 * b[1]) * inverse
    return q0, q1, (a[2] - q0 * b[2] - q1 * b[1]) * inverse


def _invert(a: Jet) -> Jet:
    q0 = 1 / a[0]
    q1 = -(q0 * q0) * a[1]
    return q0, q1, -q0 * (q1 * a[1] + q0 * a[2])


def _root(a: Jet) -> Jet:
    q0 = casadi.sqrt(a[0])
    half = 0.5 / q0
    q1 = a[1] * half
    return q0, q1, (a[2] - q1 * q1) * half


_SPECIAL: dict[int, Callable[..., Jet]] = {
    casadi.OP_DIV: _divide,
    casadi.OP_INV: _invert,
    casadi.OP_SQRT: _root,
}
"""Recurrences with fewer divisions than the chain rule."""


@cache
def _recurrence(operation: int, *given: bool) -> casadi.Function:
    """The recurrence of an operation for operands whose coefficients are `given` (three flags each); the others are zero."""
    flat = [casadi.SX.sym("x", casadi.Sparsity.dense(1, 1) if each else casadi.Sparsity(1, 1)) for each in given]
    jets: list[Jet] = [(flat[k], flat[k + 1], flat[k + 2]) for k in range(0, len(flat), 3)]
    rule = _SPECIAL.get(operation, partial(_chain_rule, operation))
    return casadi.Function("recurrence", flat, list(rule(*jets)))


def _partials(operation: int, arity: int) -> casadi.Function:
    """Value, first and halved second partial derivatives f, fx, fy, fxx/2, fxy, fyy/2 of an operation."""
    x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
    value = casadi.SX.unary(operation, x) if arity == 1 else casadi.SX.binary(operation, x, y)
    by_x, by_y = (casadi.sparsify(casadi.gradient(value, symbol)) for symbol in (x, y))
    second = [0.5 * casadi.gradient(by_x, x), casadi.gradient(by_x, y), 0.5 * casadi.gradient(by_y, y)]
    return casadi.Function("partials", [x, y], [value, by_x, by_y, *(casadi.sparsify(each) for each in second)])


def _chain_rule(operation: int, a: Jet, b: Jet = _NOTHING) -> Jet:
    """The recurrence of any operation, from its partial derivatives."""
    arity = 1 if b is _NOTHING else 2
    value, by_x, by_y, by_xx, by_xy, by_yy = _partials(operation, arity).call([a[0], b[0]])
    first = by_x * a[1] + by_y * b[1]
    linear, square = by_x * a[2] + by_y * b[2], by_xx * (a[1] * a[1]) + by_yy * (b[1] * b[1])
    return value, first, linear + by_xy * (a[1] * b[1]) + square
