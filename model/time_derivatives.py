"""Directional and total time derivatives of expressions, by forward differentiation; no Jacobian is formed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi


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
    entries: Any = casadi.jacobian(outputs, motion.a).nonzeros()
    arguments = [motion.y, motion.v, motion.a, motion.u, derived, dy, dv, du, dd]
    return arguments, casadi.vertcat(change, *entries)


def motion_rate2(
    motion: MotionSymbols, residual: casadi.SX, outputs: casadi.SX, derived: casadi.SX
) -> tuple[list[casadi.SX], casadi.SX]:
    """The second total time derivatives of residual and outputs without the terms of the snap s = d2a/dt2.

    Returns:
        arguments [y, v, a, j, u, u1, u2, d], with the jerk j = a', u1 = u' and u2 = u'', and the vector [d2r/dt2,
        d2o/dt2]; the terms of the snap are M s and do/da s.
    """
    # chain rule twice along the motion, with v = y', a = v', j = a' and the derivatives of the inputs
    y, v, a, u = motion.y, motion.v, motion.a, motion.u
    j, u1, u2 = casadi.SX.sym("j", y.numel()), casadi.SX.sym("u1", u.numel()), casadi.SX.sym("u2", u.numel())
    no_snap, both = casadi.SX.zeros(y.numel()), casadi.vertcat(residual, outputs)
    first = casadi.jtimes(both, casadi.vertcat(y, v, a, u), casadi.vertcat(v, a, j, u1))
    second = casadi.jtimes(first, casadi.vertcat(y, v, a, j, u, u1), casadi.vertcat(v, a, j, no_snap, u1, u2))
    return [y, v, a, j, u, u1, u2, derived], second
