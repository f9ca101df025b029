"""Evaluates CasADi functions of scalar operations at many points at once, each operation by numpy for all points.

CasADi's virtual machine takes 5 ns for an operation at a point, numpy 1 ns where there are two thousand points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np

from flexfmu.trajectories.jets import RealArray

CHUNK = 4096
"""Points that are evaluated together, for the sake of memory."""


OPERATIONS: dict[int, Callable[..., Any]] = {
    casadi.OP_ADD: np.add, casadi.OP_SUB: np.subtract, casadi.OP_MUL: np.multiply, casadi.OP_DIV: np.divide,
    casadi.OP_NEG: np.negative, casadi.OP_SQ: np.square, casadi.OP_SQRT: np.sqrt, casadi.OP_INV: np.reciprocal,
    casadi.OP_TWICE: lambda x, out: np.add(x, x, out=out), casadi.OP_SIN: np.sin, casadi.OP_COS: np.cos, casadi.OP_TAN: np.tan, casadi.OP_EXP: np.exp,
    casadi.OP_LOG: np.log, casadi.OP_TANH: np.tanh, casadi.OP_ATAN: np.arctan, casadi.OP_ASIN: np.arcsin,
    casadi.OP_ACOS: np.arccos, casadi.OP_SINH: np.sinh, casadi.OP_COSH: np.cosh, casadi.OP_ATAN2: np.arctan2, casadi.OP_POW: np.power, casadi.OP_CONSTPOW: np.power,
    casadi.OP_FABS: np.abs, casadi.OP_SIGN: np.sign, casadi.OP_FMIN: np.fmin, casadi.OP_FMAX: np.fmax,
    casadi.OP_ASSIGN: np.positive, casadi.OP_LT: np.less, casadi.OP_LE: np.less_equal, casadi.OP_EQ: np.equal,
    casadi.OP_NE: np.not_equal, casadi.OP_AND: np.logical_and, casadi.OP_OR: np.logical_or, casadi.OP_NOT: np.logical_not, casadi.OP_IF_ELSE_ZERO: lambda condition, x, out: np.copyto(out, np.where(condition != 0.0, x, 0.0)),
}  # fmt: skip
"""CasADi's operation → function of arrays with ``out``."""


class Vectorised:
    """A CasADi function of scalar operations for many points at once.

    Args:
        function: an SX function with dense arguments and results.

    Raises:
        NotImplementedError: it has an operation that isn't in `OPERATIONS`.
    """

    def __init__(self, function: casadi.Function) -> None:
        self._edges = np.cumsum([0, *(function.numel_in(i) for i in range(function.n_in()))])
        self.sizes = [function.numel_out(i) for i in range(function.n_out())]
        starts, inputs = np.cumsum([0, *self.sizes]), int(self._edges[-1])
        # registers: work vector, arguments, constants; each place of the work vector stands for one of them
        self._work, self._constants = function.sz_w(), list[float]()
        stands = list(range(self._work))
        self._steps = list[tuple[Callable[..., Any], tuple[int, ...], int]]()
        for k in range(function.n_instructions()):
            kind, taken, given = (
                function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
            )  # fmt: skip
            if kind == casadi.OP_INPUT:
                stands[given[0]] = self._work + int(self._edges[taken[0]]) + taken[1]
            elif kind == casadi.OP_CONST:
                stands[given[0]] = self._work + inputs + len(self._constants)
                self._constants.append(float(function.instruction_constant(k)))
            elif kind == casadi.OP_OUTPUT:
                self._steps.append((np.copyto, (stands[taken[0]],), ~(int(starts[given[0]]) + given[1])))
            elif kind in OPERATIONS:
                self._steps.append((OPERATIONS[kind], tuple(stands[i] for i in taken), given[0]))
                stands[given[0]] = given[0]
            else:
                raise NotImplementedError(f"{function.name()}: CasADi's operation {kind}")

    def __call__(self, arguments: Sequence[RealArray]) -> list[RealArray]:
        """Results (N, size) for arguments (N, size), one row for each point."""
        columns = np.concatenate([each.T for each in arguments])
        found = np.empty((sum(self.sizes), columns.shape[1]))
        for first in range(0, columns.shape[1], CHUNK):
            part = slice(first, first + CHUNK)
            self._evaluate(columns[:, part], found[:, part])
        return [each.T for each in np.split(found, np.cumsum(self.sizes)[:-1])]

    def _evaluate(self, columns: RealArray, found: RealArray) -> None:
        """Evaluate all operations, row by row."""
        registers = [*np.empty((self._work, columns.shape[1])), *columns, *self._constants]
        with np.errstate(all="ignore"):
            for function, taken, given in self._steps:
                if given < 0:
                    found[~given] = registers[taken[0]]
                else:
                    function(*[registers[i] for i in taken], out=registers[given])
