"""Total time derivatives of expressions along a motion, by forward differentiation; no Jacobian is formed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import casadi


@dataclass(frozen=True)
class Motion:
    """Symbols of the unknown coordinates y, their rates v and accelerations a (n, 1), and of the inputs u (m, 1)."""

    y: casadi.SX
    v: casadi.SX
    a: casadi.SX
    u: casadi.SX


def along_motion(
    motion: Motion, expression: casadi.SX, derived: casadi.SX, order: Literal[1, 2]
) -> tuple[list[casadi.SX], casadi.SX]:
    """First or second total time derivative of an expression in y, v, a, u and constants d.

    Returns:
        arguments [y, v, a, j, u, u1, d] (order 1) or [y, v, a, j, s, u, u1, u2, d] (order 2) and the derivative, with
        jerk j = a', s = j', u1 = u', u2 = u''.
    """
    y, v, a, u = motion.y, motion.v, motion.a, motion.u
    j, s = casadi.SX.sym("j", y.numel()), casadi.SX.sym("s", y.numel())
    u1, u2 = casadi.SX.sym("u1", u.numel()), casadi.SX.sym("u2", u.numel())
    first = casadi.jtimes(expression, casadi.vertcat(y, v, a, u), casadi.vertcat(v, a, j, u1))
    if order == 1:
        return [y, v, a, j, u, u1, derived], first
    second = casadi.jtimes(first, casadi.vertcat(y, v, a, j, u, u1), casadi.vertcat(v, a, j, s, u1, u2))
    return [y, v, a, j, s, u, u1, u2, derived], second
