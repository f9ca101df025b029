"""Discrete-time linear systems with named signals, and their blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Causality, RealArray, check_sampling
from flexfmu.model.scene.controllers import StateSpaceSection
from flexfmu.model.symbolic import SymbolicBlock, Variable


@dataclass(frozen=True)
class Signal:
    """Name and unit of an input or output; ``1`` for no unit."""

    name: str
    unit: str = "1"


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """x_k+1 = A x_k + B u_k, y_k = C x_k + D u_k; a static gain has no states, A = B = C = [].

    Attributes:
        A, B, C, D: matrices (n, n), (n, inputs), (outputs, n), (outputs, inputs), of any type that NumPy converts.
        sample_time: [s].
        inputs, outputs: signals in the order of u and y.

    Raises:
        InputError: shapes don't fit, a number isn't finite, two signals share a name, the sample time isn't positive.
    """

    A: RealArray
    B: RealArray
    C: RealArray
    D: RealArray
    sample_time: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]

    def __post_init__(self) -> None:
        check_sampling(self.sample_time, 0.0, "linear system")
        # the shapes follow from the number of states and signals
        states = np.shape(self.A)[0] if np.ndim(self.A) else 0
        shapes = {
            "A": (states, states),
            "B": (states, len(self.inputs)),
            "C": (len(self.outputs), states),
            "D": (len(self.outputs), len(self.inputs)),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, matrix(getattr(self, name), shape, name))
        # names must be unique
        names = [signal.name for signal in (*self.inputs, *self.outputs)]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"linear system: two signals are named {name!r}; give each its own name")

    @property
    def order(self) -> int:
        """Number of states n."""
        return int(self.A.shape[0])


def linear_system(
    A: Any,
    B: Any,
    C: Any,
    D: Any = None,
    *,
    sample_time: float,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
) -> LinearSystem:
    """Build a linear system from its matrices; signals are named ``u[0]``, .. and ``y[0]``, .. by default.

    Args:
        A, B, C: two-dimensional; A = [] makes a static gain, for which B and C are ignored.
        D: zero when left out.
        sample_time: [s].
        inputs, outputs: names of the signals.

    Raises:
        InputError: as for `LinearSystem`.
    """
    if np.size(A) == 0:  # a static gain: D has the numbers of inputs and outputs
        rows, columns = (len(outputs), len(inputs)) if D is None else np.atleast_2d(D).shape
        A, B, C = np.zeros((0, 0)), np.zeros((0, columns)), np.zeros((rows, 0))
    width, height = np.atleast_2d(B).shape[1], np.atleast_2d(C).shape[0]
    return LinearSystem(
        np.atleast_2d(A),
        np.atleast_2d(B),
        np.atleast_2d(C),
        np.zeros((height, width)) if D is None else np.atleast_2d(D),
        sample_time,
        tuple(Signal(name) for name in inputs or [f"u[{i}]" for i in range(width)]),
        tuple(Signal(name) for name in outputs or [f"y[{i}]" for i in range(height)]),
    )


def matrix(values: Any, shape: tuple[int, int], name: str) -> RealArray:
    """Return a read-only matrix of real, finite numbers.

    Raises:
        InputError: the shape is wrong, or a number isn't real and finite; the message has its index.
    """
    array = np.array(values)
    if array.shape in {(0,), (1, 0)} and 0 in shape:  # [] or [[]] stands for a matrix without rows or columns
        array = np.zeros(shape)
    if array.shape != shape:
        raise InputError(
            f"{name} must be {shape[0]} x {shape[1]}, got {' x '.join(map(str, array.shape)) or 'a number'}"
        )
    if not np.issubdtype(array.dtype, np.number) or np.iscomplexobj(array):
        raise InputError(f"{name} must hold real numbers, got {array.dtype}")
    wrong = np.argwhere(~np.isfinite(array))
    if wrong.size:
        i, j = wrong[0]
        raise InputError(f"{name}[{i}, {j}] must be finite, got {array[i, j]}")
    result = array.astype(float)
    result.flags.writeable = False
    return result


def state_space(
    system: LinearSystem, *, offset: float = 0.0, start: Sequence[float] | None = None, name: str = "state_space"
) -> SymbolicBlock:
    """Build the block x_k+1 = A x_k + B u_k, y_k = C x_k + D u_k; direct feedthrough where D isn't zero.

    Args:
        system: the system; its sample time and signals are the block's.
        offset: first sample instant [s].
        start: start states x_0 (n,); zero when left out.
        name: name of the block.

    Raises:
        InputError: the number of start states doesn't fit, or one isn't finite.
    """
    # one start value for each state
    states = [0.0] * system.order if start is None else [float(value) for value in start]
    if len(states) != system.order:
        raise InputError(f"{name}: start must have {system.order} values, one for each state, got {len(states)}")

    # output and update from the four matrices
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
    """Return matrix @ vector without the products with zeros."""
    return casadi.mtimes(casadi.sparsify(casadi.DM(np.asarray(matrix))), vector)


def variables(signals: Sequence[Signal], causality: Causality) -> list[Variable]:
    """Return the variables of signals; inputs start at zero."""
    what = "Input" if causality == "input" else "Output"
    start = 0.0 if causality == "input" else None
    return [Variable(signal.name, signal.unit, f"{what} {i + 1}", causality, start) for i, signal in enumerate(signals)]


@builds(StateSpaceSection)
def _from_section(section: StateSpaceSection, context: LoopContext) -> SymbolicBlock:
    s, h = section, section.sample_time
    return state_space(
        linear_system(s.A, s.B, s.C, s.D, sample_time=h, inputs=s.inputs, outputs=s.outputs), offset=s.offset
    )
