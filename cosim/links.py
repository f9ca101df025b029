"""Links between ports: which polynomial an input follows over a communication step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexfmu.cosim.hermite import two_point
from flexfmu.cosim.ports import InputPort, OutputPort
from flexfmu.cosim.slave import Indices, KnowsItsFuture, RealArray, Sampled, feedthrough, input_order, output_order
from flexfmu.cosim.system import Connection, System


@dataclass(frozen=True)
class Coupling:
    """How the signals of one slave reach another.

    Attributes:
        order: degree of the polynomial that is known at the beginning of a step.
        ends: derivatives at both ends of a step that an interpolating polynomial meets, of degree 2 ends + 1; None
            where the source is advanced later than the target, or announces its future.
        exact: whether the input arrives at the output's value at the end of a step.
    """

    order: int
    ends: int | None
    exact: bool


@dataclass(frozen=True)
class Link:
    """Outputs of one slave that feed neighbouring inputs of another.

    Attributes:
        source: port of the source.
        columns: (n,) columns of the source's signals.
        slots: which of the target's fed inputs they are.
        order, ends: see `Coupling`.
    """

    source: OutputPort
    columns: Indices
    slots: slice
    order: int
    ends: int | None

    @property
    def degree(self) -> int:
        """Highest degree of the polynomials."""
        return self.order if self.ends is None else max(self.order, 2 * self.ends + 1)

    def extrapolate(self, fed: RealArray) -> None:
        """Put value and derivatives at the current instant into ``fed`` (orders + 1, inputs)."""
        rows = self.order + 1
        if fed.shape == (rows, self.columns.size):
            self.source.signals[:rows].take(self.columns, 1, fed, "clip")
            return
        fed[:rows, self.slots] = self.source.signals[:rows, self.columns]
        fed[rows:, self.slots] = 0.0

    def ended(self) -> RealArray:
        """(ends + 1, n): signals that an interpolation meets at the current instant."""
        return self.source.signals[: (self.ends or 0) + 1, self.columns]

    def interpolate(self, begin: RealArray, step: float, fed: RealArray) -> None:
        """Put the polynomial between ``begin`` and the current instant into ``fed``."""
        fed[:, self.slots] = 0.0
        fed[: 2 * len(begin), self.slots] = two_point(begin, self.ended(), step)


def couplings(system: System) -> Mapping[tuple[int, int], Coupling]:
    """(source, target) → how its signals get there."""
    rank = {slave: i for i, slave in enumerate(system.step_order)}
    pairs = {(each.source, each.target) for each in system.connections}
    return {pair: _coupling(system, *pair, ahead=rank[pair[0]] < rank[pair[1]]) for pair in pairs}


def _coupling(system: System, source: int, target: int, ahead: bool) -> Coupling:
    """The best that source and target can do together."""
    giver, taker = system.slaves[source], system.slaves[target]
    accepted = input_order(taker)
    if isinstance(giver, KnowsItsFuture):
        order = min(giver.announced_order, accepted)
        return Coupling(order, None, giver.ends_exactly and order == giver.announced_order)
    if isinstance(giver, Sampled) or isinstance(taker, Sampled):
        return Coupling(0, None, exact=isinstance(giver, Sampled))
    known = output_order(giver)
    ends = min(known, (accepted - 1) // 2) if ahead and accepted else None
    return Coupling(min(known, accepted), ends, ends is not None)


def wire(system: System) -> tuple[list[InputPort], list[OutputPort]]:
    """Ports of all slaves, in the order of `System.slaves`."""
    coupled = couplings(system)
    outputs = [
        OutputPort(
            slave, max((max(c.order, c.ends or 0) for (source, _), c in coupled.items() if source == i), default=0)
        )
        for i, slave in enumerate(system.slaves)
    ]
    return [_input_port(system, i, outputs, coupled) for i in range(len(system.slaves))], outputs


def _input_port(
    system: System, target: int, outputs: list[OutputPort], coupled: Mapping[tuple[int, int], Coupling]
) -> InputPort:
    """The port of one slave, its inputs grouped by source."""
    incoming = sorted((each for each in system.connections if each.target == target), key=lambda each: each.source)
    links, count = [], 0
    for source in dict.fromkeys(each.source for each in incoming):
        group = [each for each in incoming if each.source == source]
        coupling = coupled[source, target]
        slots = slice(count, count + len(group))
        links.append(Link(outputs[source], _columns(outputs[source], group), slots, coupling.order, coupling.ends))
        count += len(group)
    return InputPort(system.slaves[target], np.array([each.input for each in incoming], np.intp), links)


def _columns(port: OutputPort, group: list[Connection]) -> Indices:
    """Columns of the port's signals that the connections start from."""
    return np.searchsorted(port.indices, [each.output for each in group])


def stale_after_step(system: System) -> frozenset[int]:
    """Slaves whose outputs are out of date after a step until the next exchange: a directly fed-through input has not
    arrived at its source's value, or that source is out of date itself."""
    coupled = couplings(system)
    direct = {(i, n) for i, slave in enumerate(system.slaves) for names in feedthrough(slave).values() for n in names}
    through = [e for e in system.connections if (e.target, system.slaves[e.target].variables[e.input].name) in direct]
    stale = {each.target for each in through if not coupled[each.source, each.target].exact}
    for _ in system.slaves:
        stale |= {each.target for each in through if each.source in stale}
    return frozenset(stale)


def loop_order(system: System) -> int:
    """Highest derivative that goes round a closed loop; 0 where there is none."""
    coupled = couplings(system)
    return max((coupled[each.source, each.target].order for each in system.delayed), default=0)
