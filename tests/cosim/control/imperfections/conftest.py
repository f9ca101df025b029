"""How tests run a block over many samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import casadi
import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from flexfmu.model.symbolic import SymbolicBlock

Array = NDArray[np.float64]
Run = Callable[..., Array]


def sampled(block: SymbolicBlock, inputs: ArrayLike, parameters: Mapping[str, float] | None = None) -> Array:
    """Outputs (N, outputs) of a block for inputs (N, inputs), or (N,) for all of them, at its sample instants, from its start on."""
    u = np.asarray(inputs, dtype=float)
    u = np.tile(u[:, None], len(block.inputs)) if u.ndim == 1 else u
    changes = dict(parameters or {})
    p = [changes.pop(each.name, each.start) for each in block.parameters]
    assert not changes, f"no such parameters: {changes}"
    if not block.states:
        return np.array(block.output.map(len(u))([], u.T, p)).T
    x, inp, par = (casadi.MX.sym(key, block.output.sparsity_in(i)) for i, key in enumerate("xup"))
    step = casadi.Function("step", [x, inp, par], [block.update(x, inp, par), block.output(x, inp, par)])
    _, y = step.mapaccum(len(u))(casadi.DM(block.states), u.T, casadi.DM(p))
    return np.array(y).T


@pytest.fixture(scope="session")
def run() -> Run:
    """Function (block, inputs (N, inputs), parameters) → outputs (N, outputs)."""
    return sampled
