"""Any discrete-time linear system as a block."""

from __future__ import annotations

from collections.abc import Sequence

import casadi
import numpy as np

from flexfmu.cosim.blocks.equations import Vector, block
from flexfmu.cosim.controllers.linear_system import LinearSystem, Signal
from flexfmu.cosim.errors import InputError
from flexfmu.cosim.slave import Causality, RealArray
from flexfmu.model.block import SymbolicBlock
from flexfmu.model.symbolic import Variable


def state_space(
    system: LinearSystem, *, offset: float = 0.0, start: Sequence[float] | None = None, name: str = "state_space"
) -> SymbolicBlock:
    """x_k+1 = A x_k + B u_k, y_k = C x_k + D u_k; direct feedthrough where D isn't zero.

    Args:
        system: the system; its sample time and signals are the block's.
        offset: first sample instant [s].
        start: start states x_0 (n,); zero when left out.
        name: name of the block.

    Raises:
        InputError: the number of start states doesn't fit, or one isn't finite.
    """
    states = [0.0] * system.order if start is None else [float(value) for value in start]
    if len(states) != system.order:
        raise InputError(f"{name}: start must have {system.order} values, one for each state, got {len(states)}")

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        return times(system.C, x) + times(system.D, u), times(system.A, x) + times(system.B, u)

    return block(
        name,
        f"Discrete-time linear system of order {system.order}",
        equations,
        sample_time=system.sample_time,
        offset=offset,
        inputs=variables(system.inputs, "input"),
        outputs=variables(system.outputs, "output"),
        states=states,
    )


def times(matrix: RealArray, vector: Vector) -> Vector:
    """matrix @ vector without the products by zero."""
    return casadi.mtimes(casadi.sparsify(casadi.DM(np.asarray(matrix))), vector)


def variables(signals: Sequence[Signal], causality: Causality) -> list[Variable]:
    """Variables of some signals; inputs start at zero."""
    what = "Input" if causality == "input" else "Output"
    start = 0.0 if causality == "input" else None
    return [Variable(signal.name, signal.unit, f"{what} {i + 1}", causality, start) for i, signal in enumerate(signals)]
