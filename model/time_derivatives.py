"""Directional and total time derivatives of expressions, by forward differentiation; no Jacobian is formed.

Taylor coefficients of expressions along a motion: fewer operations than differentiating twice.

Each operation gives the coefficients of its result from those of its operands, x = x0 + x1 t + x2 t^2 (A. Griewank,
A. Walther, Evaluating Derivatives, 2nd edition, SIAM 2008, chapter 13).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

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


_SPECIAL: dict[int, Callable[..., Jet]] = {casadi.OP_DIV: _divide, casadi.OP_INV: _invert, casadi.OP_SQRT: _root}
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


@dataclass(frozen=True)
class MotionSymbols:
    """Symbols of the unknown coordinates y, their rates v and accelerations a (n, 1), and of the inputs u (m, 1)."""

    y: casadi.SX
    v: casadi.SX
    a: casadi.SX
    u: casadi.SX


def forward(arguments: Sequence[casadi.SX], expression: casadi.SX) -> tuple[list[casadi.SX], casadi.SX]:
    """The directional derivative of an expression in column vectors x1, x2, ...

    Returns:
        arguments [x1, x2, ..., dx1, dx2, ...] and the derivative of `expression` along the seeds dx1, dx2, ... With the
        time derivatives of the arguments as seeds, it is the time derivative of `expression`.
    """
    seeds = [casadi.SX.sym("seed", argument.numel()) for argument in arguments]
    return [*arguments, *seeds], casadi.jtimes(expression, casadi.vertcat(*arguments), casadi.vertcat(*seeds))


def acceleration_terms(motion: MotionSymbols, outputs: casadi.SX) -> tuple[tuple[int, int], ...]:
    """(output, unknown) of each entry of do/da, column by column."""
    return tuple(zip(*casadi.jacobian(outputs, motion.a).sparsity().get_triplet(), strict=True))


def _acceleration_entries(outputs: casadi.SX, a: casadi.SX) -> Any:
    """The entries of do/da; by rows, as few outputs depend on all accelerations."""
    return casadi.jacobian(outputs, a, {"helper_options": {"ad_weight": 1.0}}).nonzeros()


def motion_forward(
    motion: MotionSymbols, residual: casadi.SX, outputs: casadi.SX, derived: casadi.SX
) -> tuple[list[casadi.SX], casadi.SX]:
    """Directional derivatives of residual r (n, 1) and outputs o (n_outputs, 1) by y, v, u and d, for constant a.

    Returns:
        arguments [y, v, a, u, d, dy, dv, du, dd] and the vector [dr, do, entries of do/da]; one function for all,
        as they have most of their operations in common.
    """
    varied = [motion.y, motion.v, motion.u, derived]
    (*_, dy, dv, du, dd), change = forward(varied, casadi.vertcat(residual, outputs))
    arguments = [motion.y, motion.v, motion.a, motion.u, derived, dy, dv, du, dd]
    return arguments, casadi.vertcat(change, *_acceleration_entries(outputs, motion.a))


def motion_rate1(
    motion: MotionSymbols, residual: casadi.SX, outputs: casadi.SX, derived: casadi.SX
) -> tuple[list[casadi.SX], casadi.SX]:
    """The time derivatives of residual and outputs without the terms of the jerk j = a'.

    Returns:
        arguments [y, v, a, u, u1, d] with u1 = u', and the vector [dr/dt, do/dt, entries of do/da]; the terms of the
        jerk are M j and do/da j.
    """
    y, v, a, u = motion.y, motion.v, motion.a, motion.u
    u1, both = casadi.SX.sym("u1", u.numel()), casadi.vertcat(residual, outputs)
    first, _ = taylor_coefficients([(y, [v]), (v, [a]), (a, []), (u, [u1]), (derived, [])], both)
    return [y, v, a, u, u1, derived], casadi.vertcat(first, *_acceleration_entries(outputs, a))


def motion_rate2(
    motion: MotionSymbols, residual: casadi.SX, outputs: casadi.SX, derived: casadi.SX
) -> tuple[list[casadi.SX], casadi.SX]:
    """The second total time derivatives of residual and outputs without the terms of the snap s = d2a/dt2.

    Returns:
        arguments [y, v, a, u, u1, d, j, u2], with u1 = u', the jerk j = a' and u2 = u'', and the vector [d2r/dt2,
        d2o/dt2]; the terms of the snap are M s and do/da s.
    """
    # Taylor coefficients along the motion, with v = y', a = v', j = a' and the derivatives of the inputs
    y, v, a, u = motion.y, motion.v, motion.a, motion.u
    j, u1, u2 = casadi.SX.sym("j", y.numel()), casadi.SX.sym("u1", u.numel()), casadi.SX.sym("u2", u.numel())
    rates = [(y, [v, 0.5 * a]), (v, [a, 0.5 * j]), (a, [j]), (u, [u1, 0.5 * u2]), (derived, [])]
    _, second = taylor_coefficients(rates, casadi.vertcat(residual, outputs))
    return [y, v, a, u, u1, derived, j, u2], 2 * second
