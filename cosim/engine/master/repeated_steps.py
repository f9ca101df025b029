"""What a repeated step needs: saved states of the slaves to go back to, and the unknown signals of a loop as one vector."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import factorial
from types import TracebackType
from typing import cast

import numpy as np

from flexfmu.cosim.engine.errors import InputError, LoopError
from flexfmu.cosim.engine.master.iteration import Solution
from flexfmu.cosim.engine.master.ports import OutputPort
from flexfmu.cosim.engine.slave import Indices, PredictsOutputs, RealArray, Sampled, SavesState, Slave, can_save


def check_can_save(slaves: Iterable[Slave], purpose: str) -> None:
    """Refuse slaves that can't go back.

    Raises:
        InputError: a slave can't save and restore its state.
    """
    for slave in slaves:
        if not can_save(slave):
            raise InputError(
                f"{slave.name} can't save and restore its state, which {purpose} needs; give it `save` and `restore` "
                f"(an FMU needs canGetAndSetFMUstate), or run without"
            )


def needs_rollback(slave: Slave) -> bool:
    """Whether the slave's state moves on in a step, so that repeating the step needs it saved.

    A slave that predicts its outputs goes to any time by `prepare`; one that samples keeps its state over a step.
    """
    return not isinstance(slave, PredictsOutputs | Sampled)


class StateKeeper:
    """The states of slaves at the time when it is made; let go at the end of a ``with`` block."""

    def __init__(self, slaves: Sequence[Slave]) -> None:
        self._states = [(slave, slave.save()) for slave in cast(Sequence[SavesState], slaves)]

    def restore(self) -> None:
        """Go back; may be repeated."""
        for slave, state in self._states:
            slave.restore(state)

    def __enter__(self) -> StateKeeper:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def release(self) -> None:
        """Let the states go."""
        for slave, state in self._states:
            # `ReleasesStates`, asked thousands of times
            if (release := getattr(slave, "release", None)) is not None:
                release(state)
        self._states = []


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
