"""Links between ports: which polynomial an input follows over a communication step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from flexfmu.cosim.master.algorithms import Algorithm
from flexfmu.cosim.master.dependencies import Connection
from flexfmu.cosim.master.linear_map import IDENTITY
from flexfmu.cosim.master.ports import InputPort, OutputPort
from flexfmu.cosim.master.selection import EVERYTHING, Selection
from flexfmu.cosim.master.stepping_order import step_order
from flexfmu.cosim.master.system import System
from flexfmu.cosim.measuring.hermite import two_point
from flexfmu.cosim.slave import Indices, KnowsItsFuture, RealArray, Sampled, feedthrough, input_order, output_order


class Transport(Enum):
    """How signals get to an input; the value says so to people."""

    ANNOUNCED = "known in advance over the whole step"
    SAMPLED = "read at the sample instants"
    HELD_SAMPLE = "held between the samples of its source"
    INTERPOLATED = "interpolated between both ends of the step"
    AVERAGED = "held at the mean of both ends of the step"
    EXTRAPOLATED = "extrapolated from the beginning of the step"


@dataclass(frozen=True)
class Coupling:
    """How the signals of one slave reach another.

    Attributes:
        transport: which way.
        order: degree of the polynomial that is known at the beginning of a step.
        ends: derivatives at both ends of a step that an interpolating polynomial meets, of degree 2 ends + 1, or that
            are averaged; None where the source is advanced later than the target, or announces its future.
        exact: whether the input arrives at the output's value at the end of a step.
    """

    transport: Transport
    order: int
    ends: int | None
    exact: bool


Couplings = Mapping[tuple[int, int], Coupling]
"""(source, target) → how its signals get there."""


@dataclass(frozen=True)
class Transformation:
    """Linear maps of neighbouring inputs.

    Attributes:
        factor, offset: (n,) y = factor x + offset.
    """

    factor: RealArray
    offset: RealArray

    def apply(self, fed: RealArray) -> None:
        """Transform values and derivatives (orders + 1, n) in place."""
        fed *= self.factor
        fed[0] += self.offset


@dataclass(frozen=True)
class Link:
    """Outputs of one slave that feed neighbouring inputs of another.

    Attributes:
        source: port of the source.
        columns: (n,) columns of the source's signals.
        slots: which of the target's fed inputs they are.
        coupling: how they get there.
        transformation: what is done to them on the way; None for nothing.
        jumping: which of the inputs change in jumps alone and have no mean of two values.
    """

    source: OutputPort
    columns: Indices
    slots: slice
    coupling: Coupling
    transformation: Transformation | None = None
    jumping: Indices = field(default_factory=lambda: np.empty(0, np.intp))

    @property
    def interpolates(self) -> bool:
        """Whether the end of a step must be known."""
        return self.coupling.ends is not None

    @property
    def degree(self) -> int:
        """Highest degree of the polynomials."""
        if self.coupling.ends is None or self.coupling.transport is Transport.AVERAGED:
            return self.coupling.order
        return max(self.coupling.order, 2 * self.coupling.ends + 1)

    def extrapolate(self, fed: RealArray) -> None:
        """Put value and derivatives at the current instant into ``fed`` (orders + 1, inputs)."""
        rows = self.coupling.order + 1
        if fed.shape == (rows, self.columns.size):
            self.source.signals[:rows].take(self.columns, 1, fed, "clip")
        else:
            fed[:rows, self.slots] = self.source.signals[:rows, self.columns]
            fed[rows:, self.slots] = 0.0
        if self.transformation is not None:
            self.transformation.apply(fed[:, self.slots])

    def ended(self) -> RealArray:
        """(ends + 1, n): signals that an interpolation meets at the current instant."""
        return self.source.signals[: (self.coupling.ends or 0) + 1, self.columns]

    def interpolate(self, begin: RealArray, step: float, fed: RealArray) -> None:
        """Put the polynomial between ``begin`` and the current instant into ``fed``."""
        fed[:, self.slots] = 0.0
        if self.coupling.transport is Transport.AVERAGED:
            mean = 0.5 * (begin[0] + self.ended()[0])
            mean[self.jumping] = begin[0, self.jumping]
            fed[0, self.slots] = mean
        else:
            fed[: 2 * len(begin), self.slots] = two_point(begin, self.ended(), step)
        if self.transformation is not None:
            self.transformation.apply(fed[:, self.slots])


def couplings(system: System, algorithm: Algorithm) -> Couplings:
    """(source, target) → how its signals get there."""
    rank = {slave: i for i, slave in enumerate(step_order(system, algorithm))}
    pairs = {(each.source, each.target) for each in system.connections}
    return {(a, b): _coupling(system, a, b, rank.get(a, -1) < rank.get(b, -1), algorithm) for a, b in pairs}


def _coupling(system: System, source: int, target: int, ahead: bool, algorithm: Algorithm) -> Coupling:
    """The best that source and target can do together."""
    giver, taker = system.slaves[source], system.slaves[target]
    used = [each.output for each in system.connections if (each.source, each.target) == (source, target)]
    accepted, known = input_order(taker), output_order(giver, used)
    if isinstance(giver, Sampled):
        return Coupling(Transport.HELD_SAMPLE, 0, None, exact=True)
    if isinstance(taker, Sampled):
        return Coupling(Transport.SAMPLED, 0, None, exact=False)
    if isinstance(giver, KnowsItsFuture):
        order = min(giver.announced_order, accepted)
        exact = giver.ends_exactly and order == giver.announced_order
        return Coupling(Transport.ANNOUNCED if exact else Transport.EXTRAPOLATED, order, None, exact)
    interpolates = algorithm.interpolates(ahead)
    if interpolates and accepted:
        return Coupling(Transport.INTERPOLATED, min(known, accepted), min(known, (accepted - 1) // 2), exact=True)
    if interpolates and algorithm.solver is not None:
        return Coupling(Transport.AVERAGED, 0, 0, exact=False)
    return Coupling(Transport.EXTRAPOLATED, min(known, accepted), None, exact=False)


def wire(
    system: System, coupled: Couplings, selection: Selection = EVERYTHING
) -> tuple[list[InputPort], list[OutputPort]]:
    """Ports of all slaves, in the order of `System.slaves`."""
    outputs = [_output_port(system, i, coupled, selection) for i in range(len(system.slaves))]
    return [_input_port(system, i, outputs, coupled) for i in range(len(system.slaves))], outputs


def _output_port(system: System, source: int, coupled: Couplings, selection: Selection) -> OutputPort:
    """The port of one slave, with as many derivatives as its targets take."""
    orders = [max(each.order, each.ends or 0) for (giver, _), each in coupled.items() if giver == source]
    fed = {each.output for each in system.connections if each.source == source}
    return OutputPort(system.slaves[source], max(orders, default=0), fed, selection)


def _input_port(system: System, target: int, outputs: list[OutputPort], coupled: Couplings) -> InputPort:
    """The port of one slave, its inputs grouped by source."""
    incoming = sorted((each for each in system.connections if each.target == target), key=lambda each: each.source)
    links, count = [], 0
    for source in dict.fromkeys(each.source for each in incoming):
        group = [each for each in incoming if each.source == source]
        slots = slice(count, count + len(group))
        place, variables = columns(outputs[source], group), system.slaves[target].variables
        jumping = np.flatnonzero([variables[each.input].discrete for each in group])
        links.append(Link(outputs[source], place, slots, coupled[source, target], transformation(group), jumping))
        count += len(group)
    return InputPort(system.slaves[target], np.array([each.input for each in incoming], np.intp), links)


def columns(port: OutputPort, group: Sequence[Connection]) -> Indices:
    """Columns of the port's signals that the connections start from."""
    return np.searchsorted(port.indices, [each.output for each in group])


def transformation(group: Sequence[Connection]) -> Transformation | None:
    """The linear maps of connections, unless all of them leave the signals as they are."""
    maps = [each.transformation for each in group]
    if all(each == IDENTITY for each in maps):
        return None
    return Transformation(np.array([each.factor for each in maps]), np.array([each.offset for each in maps]))


def stale_after_step(system: System, coupled: Couplings) -> frozenset[int]:
    """Slaves whose outputs are out of date after a step until the next exchange: a directly fed-through input has not
    arrived at its source's value, or that source is out of date itself."""
    direct = {(i, n) for i, slave in enumerate(system.slaves) for names in feedthrough(slave).values() for n in names}
    through = [e for e in system.connections if (e.target, system.slaves[e.target].variables[e.input].name) in direct]
    stale = {each.target for each in through if not coupled[each.source, each.target].exact}
    for _ in system.slaves:
        stale |= {each.target for each in through if each.source in stale}
    return frozenset(stale)


def loop_order(system: System, coupled: Couplings) -> int:
    """Highest derivative that goes round a closed loop; 0 where there is none."""
    return max((coupled[each.source, each.target].order for each in system.delayed), default=0)
