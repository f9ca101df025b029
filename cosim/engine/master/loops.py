"""Loops of signals between slaves: calls are repeated until the signals agree, at an instant or at the end of a step.

The unknown signals of a loop are one vector v, and one round of calls maps it to G(v); a solver of
`flexfmu.cosim.engine.master.iteration` finds v = G(v). Slaves are taken back to saved states before each round.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from ctypes import c_int
from dataclasses import dataclass
from math import factorial
from types import TracebackType
from typing import cast

import numpy as np

from flexfmu.cosim.engine.errors import InputError, LoopError
from flexfmu.cosim.engine.master.iteration import IterationResult, LoopSolver
from flexfmu.cosim.engine.master.ports import OutputPort, TimedCall
from flexfmu.cosim.engine.master.system import AlgebraicLoop
from flexfmu.cosim.engine.slave import Indices, PredictsOutputs, RealArray, Sampled, SavesState, Slave, can_save

INSTANT_REMEDY = (
    "solve it with Anderson() or with FixedPoint(relaxation=0.5) or less, allow more rounds or a larger tolerance, "
    "or put a slave with a state or a sample time into it"
)

STEP_REMEDY = "take a smaller communication step, a solver with more rounds or a larger tolerance"


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

    def accept(self, solution: IterationResult, loop: str, time: float, remedy: str) -> RealArray:
        """(size,) the signals that came back from the last round.

        Raises:
            LoopError: the iteration has not converged.
        """
        if not solution.converged:
            raise LoopError(self._complaint(solution, loop, time, remedy))
        np.maximum(self.scale, abs(solution.value), out=self.scale)
        return solution.value + solution.residual

    def _complaint(self, solution: IterationResult, loop: str, time: float, remedy: str) -> str:
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


@dataclass(frozen=True, slots=True)
class LoopCall:
    """One call on the way round a loop.

    Attributes:
        slave: index of the slave that is called.
        call: the call.
        read: port that it reads; None where it reads nothing.
    """

    slave: int
    call: TimedCall
    read: OutputPort | None


class InstantLoop:
    """Solves an algebraic loop at one instant.

    Args:
        loop: the loop.
        calls: what is done on the way round.
        sampling: slaves that sample on the way in one call, and whether they do so at each point: they are repeated from
            saved states.
        signals: its unknowns.
        active: index of the slave that is being called.
    """

    def __init__(
        self,
        loop: AlgebraicLoop,
        calls: Sequence[LoopCall],
        sampling: Sequence[tuple[Slave, Sequence[bool]]],
        signals: LoopSignals,
        active: c_int,
    ) -> None:
        self._loop, self._calls, self._sampling = loop, calls, sampling
        self._signals, self._active = signals, active

    def solve(self, point: int, begin: float, end: float) -> None:
        """Iterate until the signals agree at ``end``, the time of the instant.

        Raises:
            LoopError: the iteration has not converged.
        """
        signals, active = self._signals, self._active
        with StateKeeper([slave for slave, due in self._sampling if due[point]]) as states:

            def around(values: RealArray) -> RealArray:
                """One round with the unknowns assumed; what comes back."""
                states.restore()
                passed = np.empty_like(values)
                signals.scatter(values)
                for each in self._calls:
                    active.value = each.slave
                    each.call(point, begin, end)
                    # what is read comes back; those that follow are fed with what is assumed
                    if each.read is not None:
                        signals.take(each.read, passed)
                        signals.scatter(values)
                return passed

            solution = self._loop.solver.solve(around, signals.gather(), signals.scale)
        signals.scatter(signals.accept(solution, self._loop.name, end, INSTANT_REMEDY))


class IteratedStep:
    """Repeats a step of slaves that feed each other until the signals at its end agree.

    Args:
        solver: finds these signals.
        name: the loop, for messages.
        slaves: the slaves.
        calls: what is done in a step.
        signals: the unknowns: what is assumed about the end of the step.
        active: index of the slave that is being called.

    Raises:
        InputError: a slave can't go back.
    """

    def __init__(
        self,
        solver: LoopSolver,
        name: str,
        slaves: Sequence[Slave],
        calls: Sequence[LoopCall],
        signals: LoopSignals,
        active: c_int,
    ) -> None:
        check_can_save(slaves, "repeating a step")
        self._solver, self._name, self._slaves, self._calls = solver, name, slaves, calls
        self._signals, self._active = signals, active

    def solve(self, point: int, begin: float, end: float) -> None:
        """Step to ``end`` so that what is assumed about the signals there comes back.

        Raises:
            LoopError: the iteration has not converged.
        """
        with StateKeeper(self._slaves) as states:

            def around(values: RealArray) -> RealArray:
                """One step of all with the signals at the end assumed; what comes back."""
                states.restore()
                self._signals.scatter(values)
                for each in self._calls:
                    self._active.value = each.slave
                    each.call(point, begin, end)
                return self._signals.gather()

            # the first guess continues the signals over the step
            guess = self._signals.extrapolated(end - begin)
            solution = self._solver.solve(around, guess, self._signals.scale)
        self._signals.accept(solution, self._name, end, STEP_REMEDY)
