"""Directional and total time derivatives of expressions, by forward differentiation; no Jacobian is formed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi


@dataclass(frozen=True)
class Motion:
    """Symbols of the unknown coordinates y, their rates v and accelerations a (n, 1), and of the inputs u (m, 1)."""

    y: casadi.SX
    v: casadi.SX
    a: casadi.SX
    u: casadi.SX


def forward(arguments: Sequence[casadi.SX], expression: casadi.SX) -> tuple[list[casadi.SX], casadi.SX]:
    """The directional derivative of an expression in column vectors x1, x2, ...

    Returns:
        arguments [x1, x2, ..., dx1, dx2, ...] and the derivative of `expression` along the seeds dx1, dx2, ...; along
        a motion with constants, the seeds are the time derivatives of the arguments and the result is its rate.
    """
    seeds = [casadi.SX.sym("seed", argument.numel()) for argument in arguments]
    return [*arguments, *seeds], casadi.jtimes(expression, casadi.vertcat(*arguments), casadi.vertcat(*seeds))


def along_motion(motion: Motion, expression: casadi.SX, derived: casadi.SX) -> tuple[list[casadi.SX], casadi.SX]:
    """The second total time derivative of an expression in y, v, a, u and constants d.

    Returns:
        arguments [y, v, a, j, s, u, u1, u2, d] and the derivative, with jerk j = a', s = j', u1 = u', u2 = u''.
    """
    y, v, a, u = motion.y, motion.v, motion.a, motion.u
    j, s = casadi.SX.sym("j", y.numel()), casadi.SX.sym("s", y.numel())
    u1, u2 = casadi.SX.sym("u1", u.numel()), casadi.SX.sym("u2", u.numel())
    first = casadi.jtimes(expression, casadi.vertcat(y, v, a, u), casadi.vertcat(v, a, j, u1))
    second = casadi.jtimes(first, casadi.vertcat(y, v, a, j, u, u1), casadi.vertcat(v, a, j, s, u1, u2))
    return [y, v, a, j, s, u, u1, u2, derived], second
