"""Directional and total time derivatives of expressions, by forward differentiation; no Jacobian is formed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi

from flexfmu.model.taylor import taylor_coefficients


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
        arguments [y, v, a, j, u, u1, u2, d], with the jerk j = a', u1 = u' and u2 = u'', and the vector [d2r/dt2,
        d2o/dt2]; the terms of the snap are M s and do/da s.
    """
    # Taylor coefficients along the motion, with v = y', a = v', j = a' and the derivatives of the inputs
    y, v, a, u = motion.y, motion.v, motion.a, motion.u
    j, u1, u2 = casadi.SX.sym("j", y.numel()), casadi.SX.sym("u1", u.numel()), casadi.SX.sym("u2", u.numel())
    rates = [(y, [v, 0.5 * a]), (v, [a, 0.5 * j]), (a, [j]), (u, [u1, 0.5 * u2]), (derived, [])]
    _, second = taylor_coefficients(rates, casadi.vertcat(residual, outputs))
    return [y, v, a, j, u, u1, u2, derived], 2 * second
