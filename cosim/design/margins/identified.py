"""Linear blocks of what samples with unknown equations: plain Python functions and FMUs, identified from their answers.

Each input is changed for one sample, up and down; half the difference of the answers is the impulse response about the operating point. A
state-space realisation follows from the singular values of its Hankel matrix, and must predict the answer to a random input.

Source: S. Y. Kung, A new identification and model reduction algorithm via singular value decomposition, 12th Asilomar Conference on
Circuits, Systems and Computers, 1978.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexfmu.cosim.design.margins.linear_blocks import LinearBlock
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Sampled, Slave
from flexfmu.trajectories.jets import RealArray

SETTLED = 20
"""Samples at the operating point before an input is changed: memories are filled."""

HANKEL = 40
"""Samples in a row of the Hankel matrix: the largest number of states for each output."""

CHECKED = 200
"""Samples of the random input that the realisation must predict."""

CHANGE = 1e-5
"""Change of an input, relative to its size and to 1 in its unit: below what controllers' limits notice."""

LARGE = 1e4
"""Factor of a change that an input without an answer to the small one gets."""

RANK = 1e-8
"""Singular values below this share of the largest one are rounding."""

LINEAR = 1e-3
"""Largest error of the prediction, relative to the answer."""


def identified_block(slave: Slave, inputs: RealArray) -> tuple[LinearBlock, RealArray]:
    """Linearise a sampled slave at constant inputs (m,) by its answers.

    Returns:
        The block, and its outputs at the operating point (k,).

    Raises:
        InputError: it isn't sampled, or doesn't answer as a linear block with `HANKEL` states for each output.
        SlaveError: it fails.
    """
    if not isinstance(slave, Sampled):
        raise InputError(
            f"{slave.name} can't be linearised: it is stepped, not sampled; give an FMU its `sample_time` in s"
        )
    box = _Box(slave, inputs)
    rest = box.answer(np.zeros((2 * HANKEL + 1, len(inputs))))
    sizes = CHANGE * np.maximum(np.abs(inputs), 1.0)
    answers = [box.impulse(j, size, 2 * HANKEL + 1) for j, size in enumerate(sizes.tolist())]
    for j, answer in enumerate(answers):
        if not answer.any() and box.impulse(j, LARGE * float(sizes[j]), 1).any():
            raise InputError(
                f"{slave.name} can't be linearised: it answers to large changes of {box.names[j]}, not to one of {sizes[j]:.2g}: it "
                f"rounds, or has a dead zone"
            )
    response = np.stack(answers, axis=2) if answers else np.zeros((2 * HANKEL + 1, rest.shape[1], 0))
    a, b, c, d = _realised(response)
    # another answer than those that the realisation comes from
    u = sizes * np.random.default_rng(0).uniform(-1.0, 1.0, (CHECKED, len(inputs)))
    found = 0.5 * (box.answer(u) - box.answer(-u))
    error = float(np.abs(found - _predicted((a, b, c, d), u)).max(initial=0.0))
    if not error <= LINEAR * float(np.abs(found).max(initial=0.0)):
        raise InputError(
            f"{slave.name} can't be linearised: about its operating point it answers with {np.abs(found).max():.3g} and a linear "
            f"block with {len(a)} states misses that by {error:.3g}; rounding, limits that are reached and memories of more than "
            f"{HANKEL} samples do that"
        )
    return LinearBlock(a, b, c, d, slave.sample_time, float(getattr(slave, "offset", 0.0))), rest[0]


class _Box:
    """A slave that is run from its start again and again: its inputs rest at the operating point, then change."""

    def __init__(self, slave: Any, inputs: RealArray) -> None:
        self._slave, self._inputs = slave, inputs
        places: dict[str, list[int]] = {"input": [], "output": []}
        for i, each in enumerate(slave.variables):
            places.setdefault(each.causality, []).append(i)
        self.names = [slave.variables[i].name for i in places["input"]]
        self._in, self._out = np.array(places["input"], int), np.array(places["output"], int)

    def answer(self, changes: RealArray) -> RealArray:
        """Outputs (N, k) for changes (N, m) of the inputs, sample by sample."""
        slave, found = self._slave, np.empty((len(changes), len(self._out)))
        begin, step = float(getattr(slave, "offset", 0.0)), slave.sample_time
        slave.set(self._in, self._inputs)
        slave.initialize(0.0, begin + (SETTLED + len(changes) + 1) * step, None)
        try:
            for k in range(-SETTLED, len(changes)):
                slave.set(self._in, self._inputs + changes[k] if k >= 0 else self._inputs)
                slave.sample(begin + (SETTLED + k) * step)
                if k >= 0:
                    slave.get(self._out, found[k])
        finally:
            if hasattr(slave, "terminate"):
                slave.terminate()
        return found

    def impulse(self, j: int, size: float, count: int) -> RealArray:
        """Answer (count, k) to input j at one sample, by one in its unit."""
        change = np.zeros((count, len(self._inputs)))
        change[0, j] = size
        return (self.answer(change) - self.answer(-change)) / (2.0 * size)


def _realised(response: RealArray) -> tuple[RealArray, RealArray, RealArray, RealArray]:
    """A, B, C, D of an impulse response (N, k, m)."""
    _, k, m = response.shape
    rows = [[response[i + j + 1] for j in range(HANKEL)] for i in range(HANKEL)]
    shifted = [[response[i + j + 2] for j in range(HANKEL)] for i in range(HANKEL - 1)]
    # inputs and outputs of equal weight
    hankel = np.block(rows) if k and m else np.zeros((0, 0))
    if not hankel.any():
        return np.zeros((0, 0)), np.zeros((0, m)), np.zeros((k, 0)), response[0]
    outputs, inputs = (np.abs(response).max(axis=(0, axis)) for axis in (2, 1))
    left, right = (np.tile(np.where(each > 0.0, each, 1.0) ** 0.5, HANKEL) for each in (outputs, inputs))
    u, s, v = np.linalg.svd(hankel / left[:, np.newaxis] / right)
    n = int((s > RANK * s[0]).sum())
    observed = u[:, :n] * s[:n] ** 0.5
    reached = s[:n, np.newaxis] ** 0.5 * v[:n]
    # A from the shifted matrix, without the last row of blocks
    part = (HANKEL - 1) * k
    moved = np.block(shifted) / left[:part, np.newaxis] / right
    a = np.linalg.pinv(observed[:part]) @ moved @ np.linalg.pinv(reached)
    return a, reached[:, :m] * right[:m], observed[:k] * left[:k, np.newaxis], response[0]


def _predicted(matrices: tuple[RealArray, RealArray, RealArray, RealArray], u: RealArray) -> RealArray:
    """Outputs (N, k) of a realisation for inputs (N, m)."""
    a, b, c, d = matrices
    x, found = np.zeros(len(a)), np.empty((len(u), len(d)))
    for k, each in enumerate(u):
        found[k] = c @ x + d @ each
        x = a @ x + b @ each
    return found
