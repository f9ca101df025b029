"""One slave's turn in an exchange: when it is read anew, and when it samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from flexfmu.cosim.master.grid import TimeGrid
from flexfmu.cosim.master.ports import InputPort, OutputPort
from flexfmu.cosim.master.system import AlgebraicLoop, System
from flexfmu.cosim.slave import Sampled, SamplesInTwoPhases, Slave


@dataclass(frozen=True, slots=True)
class Visit:
    """One slave's turn.

    Attributes:
        index: of the slave in the system.
        slave, inputs, outputs: the slave with its ports.
        stale: whether its outputs must be read anew even where nothing jumps.
        due: whether it samples at each communication point of the grid, and once more False for points off the grid;
            empty where it doesn't sample in this turn.
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


def sampling_turns(system: System) -> Mapping[int, int]:
    """Slave → in which turn (index in `System.visits`) it has all inputs that it samples in one call."""
    turns: dict[int, int] = {}
    in_loop: dict[int, int] = {}
    rank = 0
    for each in system.exchange_order:
        for slave in each.slaves if isinstance(each, AlgebraicLoop) else [each]:
            turns[slave] = rank
            if isinstance(each, AlgebraicLoop):
                in_loop[slave] = rank
            rank += 1
    return turns | in_loop


def plan_visits(
    system: System, inputs: list[InputPort], outputs: list[OutputPort], grid: TimeGrid, stale: frozenset[int]
) -> list[Visit]:
    """The turns, in the order of `System.visits`."""
    due = {i: (*flags.tolist(), False) for i, flags in zip(clocked(system), grid.due, strict=True)}
    turns = sampling_turns(system)
    visits = []
    for rank, i in enumerate(system.visits):
        slave = system.slaves[i]
        ports = inputs[i], outputs[i], i in stale
        if isinstance(slave, SamplesInTwoPhases):
            visits.append(Visit(i, slave, *ports, due[i], slave.output, slave.update if turns[i] == rank else None))
        elif isinstance(slave, Sampled) and turns[i] == rank:
            visits.append(Visit(i, slave, *ports, due[i], slave.sample))
        else:
            visits.append(Visit(i, slave, *ports))
    return visits
