"""How tests of control run a block over many samples; they import the plant of `axis_slave` beside this file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import sampled
from numpy.typing import ArrayLike, NDArray

from flexfmu.model.symbolic import SymbolicBlock

sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder


@pytest.fixture(scope="session")
def run() -> Callable[..., Any]:
    """Function (block, inputs (N, inputs), parameters) → outputs (N, outputs)."""
    return sampled


@pytest.fixture(scope="session")
def respond() -> Callable[..., Any]:
    """(block, input or parameter → (N,) values) → output → (N,) values; inputs left out keep their start value."""
    return _respond


def _respond(block: SymbolicBlock, given: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.float64]]:
    values = {name: np.asarray(each, dtype=float) for name, each in given.items()}
    count = len(next(iter(values.values())))
    inputs = [values.get(each.name, np.full(count, each.start)) for each in block.inputs]
    parameters = {each.name: values[each.name][0] for each in block.parameters if each.name in values}
    found = sampled(block, np.column_stack(inputs), parameters)
    return {each.name: found[:, i] for i, each in enumerate(block.outputs)}
