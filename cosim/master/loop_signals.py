"""The unknowns of a loop: signals of output ports as one vector."""

from __future__ import annotations

from collections.abc import Mapping
from math import factorial

import numpy as np

from flexfmu.cosim.errors import LoopError
from flexfmu.cosim.master.iteration import Solution
from flexfmu.cosim.master.ports import OutputPort
from flexfmu.cosim.slave import Indices, RealArray


class LoopSignals:
    """Some columns of some ports, with the derivatives that go round the loop.

    Args:
        signals: port → (columns (n,), how many rows of its signals).

    Attributes:
        size: number of unknowns.
        scale: (size,) largest magnitudes of solutions so far.
    """

    def __init__(self, signals: Mapping[OutputPort, tuple[Indices, int]]) -> None:
        self._parts: list[tuple[OutputPort, Indices, int, slice]] = []
        begin = 0
        for port, (columns, rows) in signals.items():
            self._parts.append((port, columns, rows, slice(begin, begin + rows * columns.size)))
            begin += rows * columns.size
        self.size = begin
        self.scale = np.zeros(begin)

    def reset(self) -> None:
        """Forget the solutions of a run before."""
        self.scale.fill(0.0)

    def gather(self) -> RealArray:
        """(size,) the current signals."""
        values = np.empty(self.size)
        for port, columns, rows, where in self._parts:
            values[where] = port.signals[:rows, columns].ravel()
        return values

    def scatter(self, values: RealArray) -> None:
        """Make these the current signals."""
        for port, columns, rows, where in self._parts:
            port.signals[:rows, columns] = values[where].reshape(rows, -1)

    def take(self, port: OutputPort, values: RealArray) -> None:
        """Copy the port's current signals into ``values`` (size,)."""
        for each, columns, rows, where in self._parts:
            if each is port:
                values[where] = port.signals[:rows, columns].ravel()

    def extrapolated(self, step: float) -> RealArray:
        """(size,) the signals after a step [s], by their Taylor polynomials."""
        values = np.empty(self.size)
        for port, columns, rows, where in self._parts:
            known = port.signals[:, columns]
            ahead = np.zeros((rows, columns.size))
            for row in range(rows):
                for k in range(row, len(known)):
                    ahead[row] += known[k] * step ** (k - row) / factorial(k - row)
            values[where] = ahead.ravel()
        return values

    def accept(self, solution: Solution, loop: str, time: float, remedy: str) -> RealArray:
        """(size,) the signals that came back from the last round.

        Raises:
            LoopError: the iteration has not converged.
        """
        if not solution.converged:
            raise LoopError(self._complaint(solution, loop, time, remedy))
        np.maximum(self.scale, abs(solution.value), out=self.scale)
        return solution.value + solution.residual

    def _complaint(self, solution: Solution, loop: str, time: float, remedy: str) -> str:
        """What is left after the last round, and where."""
        worst = solution.worst
        residual, allowed = abs(solution.residual[worst]), solution.allowed[worst]
        return (
            f"the loop {loop} isn't solved at {time:.9g} s: after {solution.rounds} rounds {self._name(worst)} still "
            f"differs by {residual:.3g} from what comes back ({allowed:.3g} allowed); {remedy}"
        )

    def _name(self, index: int) -> str:
        """Name of an unknown."""
        for port, columns, _, where in self._parts:
            if index < where.stop:
                order, column = divmod(index - where.start, columns.size)
                variable = port.slave.variables[port.indices[columns[column]]]
                name = f"{port.slave.name}.{variable.name}"
                return f"der({name},{order})" if order else f"{name} [{variable.unit}]" if variable.unit else name
        raise IndexError(index)
