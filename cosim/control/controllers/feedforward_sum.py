"""The sum of the feedforward torques of several controllers, for the controller that adds them to its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.model.symbolic import SymbolicBlock, Variable


def feedforward_sum(
    sources: Mapping[str, Sequence[str]], *, sample_time: float, offset: float = 0.0, name: str = "feedforward_sum"
) -> SymbolicBlock:
    """Build the block: each output is the sum of the same output of several slaves, without states.

    Inputs are called like the outputs that they take, ``feedforward.joint1.feedforward``; an output is ``joint1.feedforward``.

    Args:
        sources: output [N.m] → names of the slaves that have it.
        sample_time, offset: those of the controller that takes the sum.
        name: name of the block.

    Raises:
        InputError: the sample time isn't positive.
    """
    signals = [(output, slave) for output, slaves in sources.items() for slave in slaves]

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        terms = dict(zip(signals, casadi.vertsplit(u), strict=True))
        sums = [
            casadi.sum1(casadi.vertcat(*(terms[each, slave] for slave in slaves))) for each, slaves in sources.items()
        ]
        return casadi.vertcat(*sums), x

    return block(
        name,
        "Sum of feedforward torques",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=[
            Variable(f"{slave}.{each}", "N.m", f"Term of {each} from {slave}", "input", 0.0) for each, slave in signals
        ],
        outputs=[Variable(each, "N.m", f"Sum of {each} of several controllers", "output") for each in sources],
    )
