"""Running a block by itself, sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.model.symbolic import SymbolicBlock

Array = NDArray[np.float64]
Respond = Callable[[SymbolicBlock, Mapping[str, ArrayLike]], dict[str, Array]]


@pytest.fixture(scope="session")
def respond() -> Respond:
    """(block, input → (N,) values) → output → (N,) values; inputs left out keep their start value."""
    return _respond


def _respond(block: SymbolicBlock, inputs: Mapping[str, ArrayLike]) -> dict[str, Array]:
    slave = BlockSlave(block)
    names = [variable.name for variable in slave.variables]
    fed = np.array([names.index(name) for name in inputs])
    signals = np.array(list(inputs.values()), dtype=float).T
    read = np.array([i for i, variable in enumerate(slave.variables) if variable.causality == "output"])
    results = np.empty((len(signals), read.size))
    slave.initialize(0.0, 1.0, None)
    for k, values in enumerate(signals):
        slave.set(fed, values)
        slave.sample(k * block.sample_time)
        slave.get(read, results[k])
    return {names[index]: results[:, column] for column, index in enumerate(read)}
