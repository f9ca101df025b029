"""Feedforwards of several controllers: their sum, at the instants of the controller that takes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flexfmu.cosim.engine.errors import WiringError
from flexfmu.cosim.engine.slave import HasOffset, Sampled, Slave
from flexfmu.cosim.experiment.user_slaves import SlaveNames
from flexfmu.cosim.experiment.wiring import OPTIONAL


def with_sum(controllers: Sequence[Slave], connect: Mapping[str, str], names: SlaveNames) -> tuple[Slave, ...]:
    """The controllers, and the sum of the feedforwards that several of them output.

    Args:
        controllers: the controllers.
        connect: ``slave.input`` → source; inputs that have a source here don't take the sum.
        names: assigns unique names.

    Raises:
        WiringError: the controllers that take the sum aren't sampled, or not at the same instants.
    """
    sources: dict[str, list[str]] = {}
    for each in controllers:
        for variable in each.variables:
            if variable.causality == "output" and variable.name.endswith(OPTIONAL):
                sources.setdefault(variable.name, []).append(each.name)
    several = {name: owners for name, owners in sources.items() if len(owners) > 1}
    takers = [
        each
        for each in controllers
        for variable in each.variables
        if variable.causality == "input" and variable.name in several and f"{each.name}.{variable.name}" not in connect
    ]
    if not takers:
        return tuple(controllers)
    # one clock, at whose instants the sum is up to date
    clocks = {
        (each.sample_time, each.offset if isinstance(each, HasOffset) else 0.0) if isinstance(each, Sampled) else None
        for each in takers
    }
    clock = clocks.pop()
    if clocks or clock is None:
        signal, owners = next(iter(several.items()))
        raise WiringError(
            f"{' and '.join(owners)} all output {signal}, but {', '.join(dict.fromkeys(each.name for each in takers))}, "
            "which take the sum, aren't sampled at the same instants: give them one sample_time and offset [s], or connect "
            f'one of them, connect = {{ "{signal}" = "{owners[0]}.{signal}" }} for example'
        )
    from flexfmu.cosim.control.blocks.slave import BlockSlave
    from flexfmu.cosim.control.controllers.feedforward_sum import feedforward_sum

    block = feedforward_sum(several, sample_time=clock[0], offset=clock[1], name=names.unused("feedforward_sum"))
    return (*controllers, BlockSlave(block))
