"""The steps of an exchange at a communication point: slaves are set, sampled and read; algebraic loops are iterated.

The order comes from `System.exchange_order`, which sorts slaves by direct feedthrough; a slave may have several steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from ctypes import c_int
from dataclasses import dataclass

import numpy as np

from flexfmu.cosim.engine.master.grid import TimeGrid
from flexfmu.cosim.engine.master.ports import InputPort, OutputPort
from flexfmu.cosim.engine.master.repeated_steps import LoopSignals, StateKeeper
from flexfmu.cosim.engine.master.system import AlgebraicLoop, System
from flexfmu.cosim.engine.slave import RealArray, Sampled, SamplesInTwoPhases, Slave


@dataclass(frozen=True, slots=True)
class ExchangeStep:
    """A slave is set, samples where it is due, and is read.

    Attributes:
        index: of the slave in the system.
        slave, inputs, outputs: the slave with its ports.
        stale: whether its outputs must be read anew even where nothing jumps.
        due: whether it samples at each communication point of the grid, and once more False for points off the grid;
            empty where it doesn't sample in this step.
        sample: makes it sample at a time [s].
        update: makes it move on to its next state, after the exchange; None where `sample` has done so.
    """

    index: int
    slave: Slave
    inputs: InputPort
    outputs: OutputPort
    stale: bool
    due: tuple[bool, ...] = ()
    sample: Callable[[float], None] | None = None
    update: Callable[[float], None] | None = None


def clocked(system: System) -> list[int]:
    """Slaves that sample, in the order of `TimeGrid.due`."""
    return [i for i, slave in enumerate(system.slaves) if isinstance(slave, Sampled)]


def sampling_positions(system: System) -> Mapping[int, int]:
    """Slave → position in `System.visits` at which all inputs are up to date that it samples in one call."""
    positions: dict[int, int] = {}
    in_loop: dict[int, int] = {}
    position = 0
    for each in system.exchange_order:
        for slave in each.slaves if isinstance(each, AlgebraicLoop) else [each]:
            positions[slave] = position
            if isinstance(each, AlgebraicLoop):
                in_loop[slave] = position
            position += 1
    # a slave in a loop samples there: the loop is solved with its output
    return positions | in_loop


def plan_exchange_steps(
    system: System, inputs: list[InputPort], outputs: list[OutputPort], grid: TimeGrid, stale: frozenset[int]
) -> list[ExchangeStep]:
    """The steps, in the order of `System.visits`."""
    due = {i: (*flags.tolist(), False) for i, flags in zip(clocked(system), grid.due, strict=True)}
    positions = sampling_positions(system)
    steps = []
    for position, i in enumerate(system.visits):
        slave = system.slaves[i]
        ports = inputs[i], outputs[i], i in stale
        if isinstance(slave, SamplesInTwoPhases):
            steps.append(
                ExchangeStep(i, slave, *ports, due[i], slave.output, slave.update if positions[i] == position else None)
            )
        elif isinstance(slave, Sampled) and positions[i] == position:
            steps.append(ExchangeStep(i, slave, *ports, due[i], slave.sample))
        else:
            steps.append(ExchangeStep(i, slave, *ports))
    return steps


REMEDY = (
    "solve it with Anderson() or with FixedPoint(relaxation=0.5) or less, allow more rounds or a larger tolerance, "
    "or put a slave with a state or a sample time into it"
)


class InstantLoop:
    """Solves one loop.

    Args:
        loop: the loop.
        steps: the exchange steps of a round.
        signals: its unknowns.
        active: index of the slave that is being called.
    """

    def __init__(self, loop: AlgebraicLoop, steps: Sequence[ExchangeStep], signals: LoopSignals, active: c_int) -> None:
        self._loop = loop
        self._steps = steps
        self._signals = signals
        self._active = active

    def reset(self) -> None:
        """Forget the solutions of a run before."""
        self._signals.reset()

    def solve(self, point: int, time: float) -> None:
        """Iterate until the signals agree; slaves that sample at this point are repeated from their saved states.

        Raises:
            LoopError: the iteration has not converged.
        """
        repeated = [
            each.slave
            for each in self._steps
            if each.due and each.due[point] and not isinstance(each.slave, SamplesInTwoPhases)
        ]
        with StateKeeper(repeated) as states:

            def around(values: RealArray) -> RealArray:
                states.restore()
                return self._around(values, point, time)

            solution = self._loop.solver.solve(around, self._signals.gather(), self._signals.scale)
        self._signals.scatter(self._signals.accept(solution, self._loop.name, time, REMEDY))

    def _around(self, values: RealArray, point: int, time: float) -> RealArray:
        """One round with the unknowns assumed; what comes back."""
        passed = np.empty_like(values)
        self._signals.scatter(values)
        for step in self._steps:
            self._active.value = step.index
            step.inputs.exchange()
            if step.sample is not None and step.due[point]:
                step.sample(time)
            step.outputs.read(time)
            self._signals.take(step.outputs, passed)
            self._signals.scatter(values)
        return passed
