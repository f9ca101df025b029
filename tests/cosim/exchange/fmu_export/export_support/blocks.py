"""Small discrete-time blocks, and what they do according to their own CasADi functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.model.symbolic import SymbolicBlock, Variable

Array = NDArray[np.float64]

SAMPLE_TIME = 1e-3


def block(
    name: str,
    states: Sequence[float],
    inputs: int,
    outputs: Callable[[Any, Any, Any], list[Any]],
    update: Callable[[Any, Any, Any], list[Any]],
    *,
    parameters: Sequence[Variable] = (),
    sample_time: float = SAMPLE_TIME,
    offset: float = 0.0,
    kind: Any = casadi.SX,
) -> SymbolicBlock:
    """A block with inputs ``in1``.. and outputs ``out1``.., all dimensionless; feedthrough is what the equations have."""
    sizes = (len(states), inputs, len(parameters))
    symbols = [kind.sym(symbol, size) for symbol, size in zip("xup", sizes, strict=True)]
    results = [casadi.vertcat(kind(0, 1), *make(*symbols)) for make in (outputs, update)]
    functions = [
        casadi.Function(key, symbols, [value]) for key, value in zip(("output", "update"), results, strict=True)
    ]
    depends = casadi.DM(functions[0].jac_sparsity(0, 1), 1).full()
    feedthrough = {f"out{i + 1}": tuple(f"in{j + 1}" for j in np.flatnonzero(row)) for i, row in enumerate(depends)}
    return SymbolicBlock(
        name=name,
        description=f"A block named {name}",
        feedthrough=feedthrough,
        sample_time=sample_time,
        offset=offset,
        inputs=tuple(Variable(f"in{i + 1}", "1", f"Input {i + 1}", "input", start=0.0) for i in range(inputs)),
        outputs=tuple(Variable(f"out{i + 1}", "1", f"Output {i + 1}", "output") for i in range(results[0].numel())),
        parameters=tuple(parameters),
        states=tuple(states),
        output=functions[0],
        update=functions[1],
    )


def gain(name: str, start: float, tunable: bool = False) -> Variable:
    """A dimensionless parameter from -1000 to 1000."""
    return Variable(
        name, "1", f"Parameter {name}", "parameter", start=start, minimum=-1e3, maximum=1e3, tunable=tunable
    )


def pd_controller() -> SymbolicBlock:
    """Reference, measurement → command, with a filtered derivative and parameters."""
    return block(
        "PD controller",
        [0.0, 0.0],
        2,
        lambda x, u, p: [p[0] * (u[0] - u[1]) + p[1] * (x[1] + p[2] * (u[0] - u[1] - x[0]))],
        lambda x, u, p: [u[0] - u[1], x[1] + p[2] * (u[0] - u[1] - x[0] - x[1])],
        parameters=(gain("kp", 12.0), gain("kd", 0.3, tunable=True), gain("filter", 0.2)),
    )


def fir() -> SymbolicBlock:
    """Five taps, as a shaper on a sampled signal has them."""
    taps = (0.1, 0.25, 0.3, 0.25, 0.1)
    return block(
        "fir",
        [0.0] * 4,
        1,
        lambda x, u, p: [taps[0] * u[0] + sum(taps[i + 1] * x[i] for i in range(4))],
        lambda x, u, p: [u[0], *(x[i] for i in range(3))],
    )


def delay(samples: int = 7, sample_time: float = SAMPLE_TIME, offset: float = 0.0) -> SymbolicBlock:
    """A delay line; nothing feeds through."""
    return block(
        "delay",
        [0.5] * samples,
        1,
        lambda x, u, p: [x[samples - 1]],
        lambda x, u, p: [u[0], *(x[i] for i in range(samples - 1))],
        sample_time=sample_time,
        offset=offset,
    )


def quantiser() -> SymbolicBlock:
    """Rounds down to steps of 1/64, without states."""
    return block("quantiser", [], 1, lambda x, u, p: [casadi.floor(64.0 * u[0]) / 64.0], lambda x, u, p: [])


def saturation() -> SymbolicBlock:
    """An integrator that stops at its limits, with a rate limit."""
    return block(
        "saturation",
        [0.2],
        1,
        lambda x, u, p: [casadi.fmin(casadi.fmax(x[0], -1.0), 1.0), casadi.if_else(x[0] > 0.9, 1.0, 0.0)],
        lambda x, u, p: [casadi.fmin(casadi.fmax(x[0] + casadi.fmin(casadi.fmax(u[0], -0.1), 0.1), -1.0), 1.0)],
    )


def reciprocal() -> SymbolicBlock:
    """Fails at an input of zero."""
    return block("reciprocal", [0.0], 1, lambda x, u, p: [1.0 / u[0]], lambda x, u, p: [x[0] + u[0]])


def counter(sample_time: float = SAMPLE_TIME, offset: float = 0.0) -> SymbolicBlock:
    """Puts out the number of the sample and the input at its instant."""
    return block(
        "counter",
        [0.0],
        1,
        lambda x, u, p: [x[0], u[0]],
        lambda x, u, p: [x[0] + 1.0],
        sample_time=sample_time,
        offset=offset,
    )


def linear_system(states: int, inputs: int, outputs: int) -> SymbolicBlock:
    """x+ = A x + B u, y = C x + D u, all entries being parameters in the order A, B, C, D by columns."""

    def matrices(p: casadi.SX) -> list[casadi.SX]:
        shapes = ((states, states), (states, inputs), (outputs, states), (outputs, inputs))
        ends = np.cumsum([0, *(rows * columns for rows, columns in shapes)]).tolist()
        return [casadi.reshape(p[ends[i] : ends[i + 1]], *shape) for i, shape in enumerate(shapes)]

    count = (states + outputs) * (states + inputs)
    return block(
        "linear system",
        [1.0] * states,
        inputs,
        lambda x, u, p: [matrices(p)[2] @ x + matrices(p)[3] @ u],
        lambda x, u, p: [matrices(p)[0] @ x + matrices(p)[1] @ u],
        parameters=[gain(f"entry{i + 1}", 0.0) for i in range(count)],
    )


def expected(block: SymbolicBlock, inputs: Array, parameters: Sequence[float] | None = None) -> Array:
    """Outputs (N, outputs) for the inputs (N, inputs) at the sample instants, by CasADi's virtual machine."""
    p = [each.start for each in block.parameters] if parameters is None else parameters
    x: object = list(block.states)
    rows = []
    for u in inputs:
        rows.append(np.array(block.output(x, u, p), dtype=np.float64).ravel())
        x = block.update(x, u, p)
    return np.array(rows)
