"""Linearises what samples in a loop: blocks by exact derivatives of their equations at the operating point, others by their answers.

Rounding (quantisers, encoders), dead zones and backlash count as identity. Limits that aren't reached have no influence. Random
coefficients count with
their mean. Only states count that inputs reach and that reach outputs. Functions in C have finite differences.

Plain Python functions and FMUs, whose equations are unknown, are identified: each input is changed for one sample, up and down; half
the difference of the answers is the impulse response about the operating point. A state-space realisation follows from the singular
values of its Hankel matrix, and must predict the answer to a random input.

Source: S. Y. Kung, A new identification and model reduction algorithm via singular value decomposition, 12th Asilomar Conference on
Circuits, Systems and Computers, 1978.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Sampled, Slave
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.jets import RealArray

LARGE = 1e9
"""Change of an input, in its unit, for which dead zones and backlash don't matter."""

AVERAGED = 2000
"""Samples over which random coefficients, as of jitter, are averaged."""

SAMPLES = 20
"""Samples after which the states of a block count as those of the operating point: memories are filled."""

SETTLED = 20
"""Samples at the operating point before an input is changed: memories are filled."""

HANKEL = 40
"""Samples in a row of the Hankel matrix: the largest number of states for each output."""

CHECKED = 200
"""Samples of the random input that the realisation must predict."""

CHANGE = 1e-5
"""Change of an input, relative to its size and to 1 in its unit: below what controllers' limits notice."""

LARGER = 1e4
"""Factor of a change that an input without an answer to the small one gets."""

RANK = 1e-8
"""Singular values below this share of the largest one are rounding."""

LINEAR = 1e-3
"""Largest error of the prediction, relative to the answer."""


@dataclass(frozen=True, eq=False)
class LinearBlock:
    """x_k+1 = A x_k + B u_k, y_k = C x_k + D u_k in deviations from the operating point, at instants offset + k sample_time."""

    a: RealArray
    b: RealArray
    c: RealArray
    d: RealArray
    sample_time: float
    offset: float

    def within(self, inputs: NDArray[np.bool_], outputs: NDArray[np.bool_]) -> LinearBlock:
        """The block without the states that none of these inputs (m,) reaches, or that reach none of these outputs (k,)."""
        kept = sorted({*_reached(self.a, self.b[:, inputs])} & {*_reached(self.a.T, self.c[outputs].T)})
        return replace(self, a=self.a[np.ix_(kept, kept)], b=self.b[kept], c=self.c[:, kept])

    def equals(self, other: LinearBlock) -> bool:
        """Whether the matrices are the same."""
        return all(map(np.array_equal, (self.a, self.b, self.c, self.d), (other.a, other.b, other.c, other.d)))


def linear_block(slave: Slave, inputs: RealArray) -> tuple[LinearBlock, RealArray]:
    """Linearise a sampled slave at constant inputs (m,).

    Returns:
        The block, and its outputs at the operating point (k,).

    Raises:
        InputError: the slave isn't a block, so that its equations aren't known.
    """
    if not isinstance(slave, BlockSlave):
        raise InputError(
            f"{slave.name} can't be linearised, as its equations aren't known: margins need controllers and imperfections of the "
            f"toolkit, python-control systems or own blocks"
        )
    block = slave.block
    states, parameters = np.array(block.states), [each.start or 0.0 for each in block.parameters]
    for _ in range(SAMPLES):
        states = np.asarray(block.update(states, inputs, parameters).full())[:, 0]
    a, b, c, d = _derivatives(slave, states, inputs, parameters)
    if len(inputs) and not (b.any() or d.any()):
        # dead zones and backlash: the gain for large signals, which all pass
        a, b, c = np.zeros((0, 0)), np.zeros((0, len(inputs))), np.zeros((len(block.outputs), 0))
        d = _gain(block, inputs)
    outputs = np.asarray(block.output(states, inputs, parameters).full())[:, 0]
    linear = LinearBlock(a, b, c, d, block.sample_time, block.offset)
    linear = linear.within(np.ones(len(inputs), bool), np.ones(len(outputs), bool))
    if not all(np.isfinite(each).all() for each in (linear.a, linear.b, linear.c, linear.d)):
        raise InputError(f"{slave.name} has no finite derivatives at its operating point")
    return linear, outputs


_known: WeakKeyDictionary[BlockSlave, casadi.Function] = WeakKeyDictionary()
"""Derivatives of blocks, which are evaluated at many operating points."""


def _derivatives(
    slave: BlockSlave, states: RealArray, inputs: RealArray, parameters: list[float]
) -> tuple[RealArray, RealArray, RealArray, RealArray]:
    """A, B, C, D at a point; of a block with random numbers, which no input reaches, their mean over many samples."""
    block = slave.block
    if slave not in _known:
        _known[slave] = _jacobians(block)
    jacobians = _known[slave]
    found = [np.asarray(each.full()) for each in jacobians(states, inputs, parameters)]
    if not len(inputs) or len(_reached(*found[:2])) == len(states):
        return found[0], found[1], found[2], found[3]
    # states that go their own way, sample after sample; numbers that add don't change the derivatives
    following = np.asarray(block.update(states, inputs, parameters).full())[:, 0]
    if all(map(np.array_equal, (each.full() for each in jacobians(following, inputs, parameters)), found)):
        return found[0], found[1], found[2], found[3]
    update = casadi.Function("update", [x := casadi.MX.sym("x", len(states))], [block.update(x, inputs, parameters)])
    course = np.hstack([states[:, np.newaxis], np.asarray(update.mapaccum(AVERAGED)(states).full())])
    same = [casadi.repmat(each, 1, AVERAGED + 1) for each in (inputs, parameters)]
    several = jacobians.map(AVERAGED + 1)(course, *same)
    a, b, c, d = (
        np.asarray(many.full()).reshape(len(one), AVERAGED + 1, -1).mean(axis=1)
        for many, one in zip(several, found, strict=True)
    )
    return a, b, c, d


def _gain(block: SymbolicBlock, inputs: RealArray) -> RealArray:
    """Gain of a block's first sample for large changes of each input."""
    states, parameters = block.states, [each.start or 0.0 for each in block.parameters]
    found = []
    for direction in np.eye(len(inputs)):
        far, near = (
            block.output(states, inputs + sign * LARGE * direction, parameters).full()[:, 0] for sign in (1, -1)
        )
        found.append((far - near) / (2.0 * LARGE))
    return np.array(found).T


def _jacobians(block: SymbolicBlock) -> casadi.Function:
    """(x, u, p) → A, B, C, D."""
    sizes = (len(block.states), len(block.inputs), len(block.parameters))
    scalar = [found for each in (block.update, block.output) if (found := _scalar(each)) is not None]
    is_scalar = len(scalar) == 2
    symbol: Any = casadi.SX if is_scalar else casadi.MX
    x, u, p = (symbol.sym(name, size) for name, size in zip("xup", sizes, strict=True))
    errors: list[tuple[Any, Any]] = []
    if is_scalar:
        following, output = (_without_rounding(each, [x, u, p], errors) for each in scalar)
    else:
        following, output = (each.call([x, u, p])[0] for each in (block.update, block.output))
    pairs = ((following, x), (following, u), (output, x), (output, u))
    derivatives = [casadi.densify(casadi.jacobian(y, z)) for y, z in pairs]
    if errors:
        derivatives = casadi.substitute(derivatives, *map(list, zip(*errors, strict=True)))
    return casadi.Function("jacobians", [x, u, p], derivatives)


def _scalar(function: casadi.Function) -> casadi.Function | None:
    """The function of scalar operations; None if it calls others, as one in C or a table, which have derivatives of their own."""
    if function.class_name() != "SXFunction":
        try:
            function = function.expand()
        except RuntimeError:
            return None
    kinds = {function.instruction_id(k) for k in range(function.n_instructions())}
    return None if casadi.OP_CALL in kinds else function


def _without_rounding(function: casadi.Function, arguments: list[Any], errors: list[tuple[Any, Any]]) -> Any:
    """The result of a function of scalar operations for symbols, whose roundings have the derivative of the identity.

    Each rounding adds a symbol for its error, and the error's value, to ``errors``: derivatives see a constant.
    """
    work: list[Any] = [casadi.SX(0)] * function.sz_w()
    true = list(work)
    result = casadi.SX.zeros(function.numel_out(0))
    for k in range(function.n_instructions()):
        kind, taken, given = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if kind == casadi.OP_INPUT:
            work[given[0]] = true[given[0]] = arguments[taken[0]][taken[1]]
        elif kind == casadi.OP_CONST:
            work[given[0]] = true[given[0]] = casadi.SX(function.instruction_constant(k))
        elif kind == casadi.OP_OUTPUT:
            result[given[1]] = work[taken[0]]
        elif kind in (casadi.OP_FLOOR, casadi.OP_CEIL):
            rounded = casadi.SX.unary(kind, true[taken[0]])
            errors.append((casadi.SX.sym(f"rounding{len(errors)}"), rounded - true[taken[0]]))
            work[given[0]], true[given[0]] = work[taken[0]] + errors[-1][0], rounded
        else:
            make = casadi.SX.unary if len(taken) == 1 else casadi.SX.binary
            work[given[0]], true[given[0]] = (make(kind, *(each[i] for i in taken)) for each in (work, true))
    return result


def _reached(a: RealArray, b: RealArray) -> list[int]:
    """Indices of the states that inputs reach."""
    reached = np.any(b != 0.0, axis=1)
    for _ in range(len(a)):
        more = reached | np.any(a[:, reached] != 0.0, axis=1)
        if (more == reached).all():
            break
        reached = more
    return [int(i) for i in np.flatnonzero(reached)]


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
        if not answer.any() and box.impulse(j, LARGER * float(sizes[j]), 1).any():
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
