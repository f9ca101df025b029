"""First-order lag: what a current loop or an amplifier does to its command."""

from __future__ import annotations

from collections.abc import Sequence

import casadi

from flexfmu.cosim.blocks.equations import Vector, block, split
from flexfmu.cosim.imperfections.channels import Channel
from flexfmu.cosim.imperfections.memory import empty, recall, remember
from flexfmu.cosim.imperfections.variables import (
    PerChannel,
    initial_parameters,
    inputs,
    outputs,
    parameters,
    require_initial,
)
from flexfmu.model.block import SymbolicBlock


def lag(
    channels: Sequence[Channel],
    time_constant: PerChannel,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "lag",
) -> SymbolicBlock:
    """T y' + y = u at the sample instants, exact for an input that is held between them.

    With sample time h and a = exp(-h / T)::

        y_k+1 = a y_k + (1 - a) u_k

    (zero-order-hold equivalent: G. F. Franklin, J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd ed.
    1998, section 4.3). The output is a staircase, half a sample late on average; a sample time of T / 10 makes it a good
    current loop. It doesn't depend on the input of the same instant, so it breaks algebraic loops. T = 0 is a delay of
    one sample. The time constant is a tunable parameter ``<channel>.time_constant``.

    Args:
        channels: the commands, usually torques, with initial values.
        time_constant: T [s], zero or positive: 1 / (2 pi f) for a bandwidth f [Hz].
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: a channel has no initial value, a time constant is negative or not finite, or the sample time isn't
            positive.
    """
    ports = inputs(channels)
    require_initial(channels, name)
    n, h = len(channels), sample_time

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        time, initial = split(p, n)
        y = recall(x, initial)
        return y, remember(u + casadi.exp(-h / time) * (y - u))

    return block(
        name,
        "First-order lag",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=ports,
        outputs=outputs(channels),
        parameters=[
            *parameters(channels, "time_constant", time_constant, ["s"] * n, "the time constant", minimum=0.0),
            *initial_parameters(channels),
        ],
        states=empty(n),
    )
