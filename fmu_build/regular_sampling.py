"""Blocks that sample at given instants as blocks with a sample time, which an FMU needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import reduce
from math import gcd, inf, lcm

import casadi

from flexfmu.fmu_build.errors import ModelError
from flexfmu.model.symbolic import SymbolicBlock

IDLE = Fraction(1)
"""Sample time of a block whose output doesn't change [s]."""

SHORTEST = 1e-6
"""Shortest common step of several times [s]; a shorter one suggests times that differ by mistake."""


def regular(block: SymbolicBlock) -> SymbolicBlock:
    """Return a block with a sample time alone: where it has further instants, it samples at the common step of all of them.

    Its outputs are the same: between its own samples it holds them.

    Raises:
        ModelError: the instants have no common step of 1 µs or more.
    """
    if not block.instants:
        return block
    instants = [exact(each) for each in block.instants]
    periodic = [exact(block.offset), exact(block.sample_time)] if block.sample_time < inf else []
    step = common_step([*instants, *periodic], f"block '{block.name}'")
    # states: number of the sample, the block's own, the outputs
    own, outputs = len(block.states), len(block.outputs)
    x, u, p = (
        casadi.SX.sym(letter, count) for letter, count in zip("xup", (1 + own + outputs, *_sizes(block)), strict=True)
    )
    count, states, held = casadi.vertsplit(x, [0, 1, 1 + own, 1 + own + outputs])
    due = casadi.sum1(casadi.vertcat(*(count == int(each / step) for each in instants)))
    if periodic:
        first, every = (int(each / step) for each in periodic)
        due += casadi.logic_and(count >= first, casadi.fmod(count - first, every) == 0.0)
    output = casadi.densify(casadi.if_else(due > 0.0, block.output(states, u, p), held))
    following = casadi.if_else(due > 0.0, block.update(states, u, p), states)
    update = casadi.densify(casadi.vertcat(count + 1.0, following, output))
    return replace(
        block,
        sample_time=float(step),
        offset=0.0,
        instants=(),
        states=(0.0, *block.states, *(0.0 for _ in block.outputs)),
        output=casadi.Function("output", [x, u, p], [output], ["x", "u", "p"], ["y"]),
        update=casadi.Function("update", [x, u, p], [update], ["x", "u", "p"], ["next_x"]),
    )


def _sizes(block: SymbolicBlock) -> tuple[int, int]:
    return len(block.inputs), len(block.parameters)


def exact(time: float) -> Fraction:
    """Return the time that a user writes, not the nearest binary number: to 1e-12 s."""
    return Fraction(repr(round(float(time), 12)))


def common_step(times: Sequence[Fraction], where: str) -> Fraction:
    """Return the longest time of which all are multiples.

    Raises:
        ModelError: it is below `SHORTEST`.
    """
    positive = [each for each in times if each] or [IDLE]
    denominator = lcm(*(each.denominator for each in positive))
    step = Fraction(reduce(gcd, (int(each * denominator) for each in positive)), denominator)
    if step < Fraction(SHORTEST):
        listed = ", ".join(f"{float(each):g}" for each in positive)
        raise ModelError(f"{where}: the times {listed} s have no common step of 1 µs or more: round them")
    return step
