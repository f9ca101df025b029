"""Loops of signals between slaves: calls are iterated until the signals agree, at an instant or at the end of a step.

The unknown signals of a loop form a vector v, and one round of calls maps it to G(v); a solver of
`flexfmu.cosim.engine.master.iteration` finds v = G(v). Slaves are rolled back to saved states before each round.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from ctypes import c_int
from math import factorial
from typing import cast

import numpy as np

from flexfmu.cosim.engine.errors import InputError, LoopError
from flexfmu.cosim.engine.master.iteration import IterationResult, LoopSolver
from flexfmu.cosim.engine.master.ports import OutputPort, TimedCall
from flexfmu.cosim.engine.slave import Indices, PredictsOutputs, RealArray, Sampled, SavesState, Slave, can_save

INSTANT_REMEDY = (
    "solve it with Anderson() or with FixedPoint(relaxation=0.5) or less, allow more rounds or a larger tolerance, "
    "or put a slave with a state or a sample time into it"
)

STEP_REMEDY = "take a smaller communication step, a solver with more rounds or a larger tolerance"


def check_can_save(slaves: Iterable[Slave], purpose: str) -> None:
    """Refuse slaves that can't be rolled back.

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
    """Whether the slave's state changes in a step, so that repeating the step needs a saved state.

    A slave that predicts its outputs can be set to any time by `prepare`; a sampled slave keeps its state over a step.
    """
    return not isinstance(slave, PredictsOutputs | Sampled)


class StateKeeper:
    """Saved states of slaves, taken on construction and released at the end of a ``with`` block."""

    def __init__(self, slaves: Sequence[Slave]) -> None:
        self._states = [(slave, slave.save()) for slave in cast(Sequence[SavesState], slaves)]

    def restore(self) -> None:
        """Roll the slaves back; may be repeated."""
        for slave, state in self._states:
            slave.restore(state)

    def __enter__(self) -> StateKeeper:
        return self

    def __exit__(self, *error: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the states."""
        for slave, state in self._states:
            if (release := getattr(slave, "release", None)) is not None:
                release(state)
        self._states = []


class LoopSignals:
    """The unknown signals of a loop, with their derivatives, as one vector.

    Args:
        signals: port → (columns (n,) of its signals, number of rows: 1 for values alone, more with derivatives).

    Attributes:
        size: number of unknowns.
        scale: (size,) largest magnitudes of the solutions so far in the run.
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
        """Discard the magnitudes of an earlier run."""
        self.scale.fill(0.0)

    def gather(self) -> RealArray:
        """(size,) the ports' current signals."""
        values = np.empty(self.size)
        for port, columns, rows, where in self._parts:
            values[where] = port.signals[:rows, columns].ravel()
        return values

    def scatter(self, values: RealArray) -> None:
        """Write ``values`` (size,) into the ports' current signals."""
        for port, columns, rows, where in self._parts:
            port.signals[:rows, columns] = values[where].reshape(rows, -1)

    def take(self, port: OutputPort, values: RealArray) -> None:
        """Copy the port's current signals into ``values`` (size,)."""
        for each, columns, rows, where in self._parts:
            if each is port:
                values[where] = port.signals[:rows, columns].ravel()

    def extrapolated(self, step: float) -> RealArray:
        """(size,) the signals after a step [s], extrapolated by Taylor polynomials."""
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
        """(size,) G(v) of the last round, after the magnitudes have been updated.

        Raises:
            LoopError: the iteration has not converged.
        """
        if not solution.converged:
            worst = solution.worst
            residual, allowed = abs(solution.residual[worst]), solution.allowed[worst]
            raise LoopError(
                f"the loop {loop} isn't solved at {time:.9g} s: after {solution.rounds} rounds {self._name(worst)} still "
                f"differs by {residual:.3g} from what comes back ({allowed:.3g} allowed); {remedy}"
            )
        np.maximum(self.scale, abs(solution.value), out=self.scale)
        return solution.value + solution.residual

    def _name(self, index: int) -> str:
        """Name of the unknown with this index, with its unit if known."""
        for port, columns, _, where in self._parts:
            if index < where.stop:
                order, column = divmod(index - where.start, columns.size)
                variable = port.slave.variables[port.indices[columns[column]]]
                name = f"{port.slave.name}.{variable.name}"
                return f"der({name},{order})" if order else f"{name} [{variable.unit}]" if variable.unit else name
        raise IndexError(index)


LoopCall = tuple[int, TimedCall, OutputPort | None]
"""One call in a round of a loop: index of the slave that is called, the call, and the port whose signals it reads, None if it reads nothing."""


def solution(
    solver: LoopSolver,
    name: str,
    calls: Sequence[LoopCall],
    repeated: Sequence[tuple[Slave, Sequence[int] | None]],
    signals: LoopSignals,
    active: c_int,
    *,
    at_instant: bool,
) -> TimedCall:
    """A call that iterates a loop until its signals agree: at an instant, or those assumed at the end of a step with those reached.

    The call raises `LoopError` if the iteration doesn't converge.

    Args:
        solver: solves for the signals.
        name: the loop, for messages.
        calls: the calls of one round.
        repeated: slaves that are rolled back before each round, and whether each is called at each point; None for always.
        signals: the unknowns.
        active: set to the index of the slave that is being called.
        at_instant: whether the loop is an algebraic one at the instant ``end``, else a step.
    """

    def solve(point: int, begin: float, end: float) -> None:
        with StateKeeper([slave for slave, due in repeated if due is None or due[point]]) as states:

            def around(values: RealArray) -> RealArray:
                """One round of calls with the assumed unknowns; G(v)."""
                states.restore()
                passed = np.empty_like(values)
                signals.scatter(values)
                for slave, call, read in calls:
                    active.value = slave
                    call(point, begin, end)
                    # keep what the call has read, and feed the following slaves with the assumed values
                    if at_instant and read is not None:
                        signals.take(read, passed)
                        signals.scatter(values)
                return passed if at_instant else signals.gather()

            # over a step the guess is an extrapolation
            guess = signals.gather() if at_instant else signals.extrapolated(end - begin)
            found = solver.solve(around, guess, signals.scale)
        agreed = signals.accept(found, name, end, INSTANT_REMEDY if at_instant else STEP_REMEDY)
        if at_instant:
            signals.scatter(agreed)

    return solve
