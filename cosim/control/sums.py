"""Sums of what several slaves output under one name: feedforward torques, and disturbances that act on one signal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from math import inf
from typing import Unpack

import casadi

from flexfmu.cosim.control.blocks.equations import BlockOptions, block, split
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.named_signals import unit_of
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Slave
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.regular_sampling import common_step, exact
from flexfmu.model.symbolic import SymbolicBlock, Variable


def feedforward_sum(sources: Mapping[str, Sequence[str]], **options: Unpack[BlockOptions]) -> SymbolicBlock:
    """Build the block: each output is the sum of the same output of several slaves, without states.

    Inputs are called like the outputs that they take, ``feedforward.joint1.feedforward``; an output is ``joint1.feedforward``.

    Args:
        sources: output [N.m] → names of the slaves that have it.
        options: ``sample_time`` and ``offset``, those of the controller that takes the sum, and ``name``.

    Raises:
        InputError: the sample time isn't positive.
    """
    signals = [(output, slave) for output, slaves in sources.items() for slave in slaves]
    sizes = [len(slaves) for slaves in sources.values()]
    return block(
        "feedforward_sum",
        "Sum of feedforward torques",
        lambda x, u, p: (casadi.vertcat(*(casadi.sum1(each) for each in split(u, *sizes))), x),
        inputs=[Variable(f"{who}.{what}", "N.m", f"Term of {what} from {who}", "input", 0.0) for what, who in signals],
        outputs=[Variable(each, "N.m", f"Sum of {each} of several controllers", "output") for each in sources],
        **options,
    )


def disturbance_sum(
    signal: str, sources: Sequence[str], *, instants: Sequence[float] = (), **options: Unpack[BlockOptions]
) -> SymbolicBlock:
    """Build the block: the sum of a signal of several slaves, with inputs ``slave.signal``; times as for `block`.

    Raises:
        InputError: the sample time isn't positive.
    """
    unit = unit_of(signal)
    return block(
        "disturbance_sum",
        "Sum of disturbances",
        lambda x, u, p: (casadi.sum1(u), x),
        instants=instants,
        inputs=[Variable(f"{each}.{signal}", unit, f"Term from {each}", "input", 0.0) for each in sources],
        outputs=[Variable(signal, unit, "Sum of all terms", "output")],
        **options,
    )


def with_sums(disturbances: Sequence[Slave], unused: Callable[[str], str]) -> list[Slave]:
    """The disturbances, and a sum for each signal of several: at the common step of their samples and at all of their instants.

    Args:
        disturbances: the slaves.
        unused: assigns a unique name.

    Raises:
        InputError: disturbances that add up aren't blocks, or their samples have no common step of 1 µs or more.
    """
    owners: dict[str, list[Slave]] = {}
    for each in disturbances:
        for variable in each.variables:
            if variable.causality == "output":
                owners.setdefault(variable.name, []).append(each)
    sums = []
    for signal, slaves in owners.items():
        if len(slaves) == 1:
            continue
        clocks, instants = list[Fraction](), set[float]()
        for each in slaves:
            if not isinstance(each, BlockSlave):
                raise InputError(f"{each.name} and another slave output {signal}: only blocks add up, leave one out")
            instants.update(each.instants)
            if each.sample_time < inf:
                clocks += [exact(each.offset), exact(each.sample_time)]
        try:
            step = float(common_step(clocks, f"disturbances in {signal}")) if clocks else inf
        except ModelError as error:
            raise InputError(str(error)) from None
        names, name = [each.name for each in slaves], unused("disturbance_sum")
        total = disturbance_sum(signal, names, sample_time=step, instants=sorted(instants), name=name)
        sums.append(BlockSlave(total))
    return [*disturbances, *sums]
