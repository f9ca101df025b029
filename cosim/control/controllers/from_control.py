"""Discrete-time linear systems with named signals and their blocks, also of python-control's systems."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from scipy.linalg import block_diag

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.joints import check_units, named_signals
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray, check_sampling
from flexfmu.model.scene.controllers import StateSpaceSection
from flexfmu.model.symbolic import SymbolicBlock, Variable


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """x_k+1 = A x_k + B u_k, y_k = C x_k + D u_k; a static gain has no states, A = B = C = [].

    Attributes:
        A, B, C, D: matrices (n, n), (n, inputs), (outputs, n), (outputs, inputs), of any type that NumPy converts.
        sample_time: [s].
        inputs, outputs: variables in the order of u and y.

    Raises:
        InputError: shapes don't fit, a number isn't finite, the sample time isn't positive.
    """

    A: RealArray
    B: RealArray
    C: RealArray
    D: RealArray
    sample_time: float
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]

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

    @property
    def order(self) -> int:
        """Number of states n."""
        return int(self.A.shape[0])


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
        inputs=system.inputs,
        outputs=system.outputs,
        states=states,
    )


def times(matrix: RealArray, vector: Vector) -> Vector:
    """Return matrix @ vector without the products with zeros."""
    return casadi.mtimes(casadi.sparsify(casadi.DM(np.asarray(matrix))), vector)


@builds(StateSpaceSection)
def _of_section(s: StateSpaceSection, context: LoopContext) -> SymbolicBlock:
    # without states it is a static gain, whatever stands in B and C
    A, B, C = (s.A, s.B, s.C) if np.size(s.A) else ((), (), ())
    D = np.zeros((len(s.outputs), len(s.inputs))) if s.D is None else s.D
    matrices = np.array(A), np.array(B), np.array(C), np.array(D)
    signals = tuple(named_signals(s.inputs, "input", {})), tuple(named_signals(s.outputs, "output", {}))
    return state_space(LinearSystem(*matrices, s.sample_time, *signals), offset=s.offset)


_OBJECT = re.compile(r"^(joint\d+|link\d+|end_effector|force)_")
_QUANTITY = re.compile(r"\.(reference|position|velocity|acceleration)_(position|velocity|acceleration|x|y)$")


def control_block(
    system: Any,
    *,
    offset: float = 0.0,
    start: Sequence[float] | None = None,
    name: str = "controller",
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
) -> SymbolicBlock:
    """Build the block of a `control.StateSpace` or `control.TransferFunction`.

    Args:
        system, inputs, outputs, units: as for `from_control`.
        offset: first sample instant [s].
        start: start states of a state space (n,); zero when left out.
        name: name of the block.

    Raises:
        InputError: as for `from_control`.
    """
    linear = from_control(system, inputs=inputs, outputs=outputs, units=units)
    return state_space(linear, offset=offset, start=start, name=name)


def from_control(
    system: Any,
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
) -> LinearSystem:
    """Return the discrete-time system of a `control.StateSpace` or `control.TransferFunction`.

    It may have any number of inputs and outputs, and keeps its matrices and its sample time. Labels become names;
    python-control allows no dots in them, so `dotted` restores the dots of the robot's variables.

    Args:
        system: the system.
        inputs, outputs: names that replace the labels.
        units: name → unit, where it isn't that of the robot's signal; a signal without a unit connects to any unit.

    Raises:
        InputError: the system is of another kind, continuous, without sample time, or not proper, or a name is unknown.
    """
    import control

    units = units or {}
    if isinstance(system, control.StateSpace):
        matrices = system.A, system.B, system.C, system.D
    elif isinstance(system, control.TransferFunction):
        matrices = realise(system.num_array, system.den_array)
    else:
        raise InputError(
            f"need a control.StateSpace or control.TransferFunction, got {type(system).__name__}; convert it with control.ss"
        )
    names_in = _names(inputs, system.input_labels, "inputs")
    names_out = _names(outputs, system.output_labels, "outputs")
    check_units(units, [*names_in, *names_out], "linear system")
    if system.dt is None or system.dt is True:
        raise InputError(f"the system has no sample time (dt is {system.dt}): set system.dt, in s")
    if system.isctime(strict=True):
        raise InputError(
            'the system is continuous: discretise it first, for example control.c2d(system, 1e-3, "tustin") for a sample time '
            "of 1 ms"
        )
    signals_in, signals_out = named_signals(names_in, "input", units), named_signals(names_out, "output", units)
    return LinearSystem(*matrices, float(system.dt), tuple(signals_in), tuple(signals_out))


def dotted(label: str) -> str:
    """Restore the dots in a variable's name that `flexfmu.model.linear` replaced by underscores.

    ``joint1_torque`` → ``joint1.torque``, ``end_effector_position_x`` → ``end_effector.position.x``. Other labels stay
    as they are.
    """
    return _QUANTITY.sub(r".\1.\2", _OBJECT.sub(r"\1.", label))


def _names(given: Sequence[str] | None, labels: Sequence[str], what: str) -> list[str]:
    """Return the names that replace the labels, or the labels with their dots."""
    if given is None:
        return [dotted(label) for label in labels]
    if isinstance(given, str) or len(given) != len(labels):
        raise InputError(
            f"{what} must be a sequence of {len(labels)} names, one for each of {list(labels)}, got {given!r}"
        )
    return list(given)


Matrices = tuple[RealArray, RealArray, RealArray, RealArray]
"""A (n, n), B (n, inputs), C (outputs, n), D (outputs, inputs)."""


def realise(numerators: Sequence[Sequence[RealArray]], denominators: Sequence[Sequence[RealArray]]) -> Matrices:
    """Return a state space of a matrix of transfer functions in s or z.

    Every element is realised in its own controllable canonical form (T. Kailath, Linear Systems, 1980, section 2.1.1).
    The realisation isn't minimal where elements share poles; the response is the same.

    Args:
        numerators, denominators: [output][input] → coefficients, highest power first.

    Raises:
        InputError: an element isn't proper.
    """
    height, width = len(numerators), len(numerators[0])
    D = np.zeros((height, width))
    # states, input column and output row of every element
    parts, rows, columns = list[RealArray](), list[RealArray](), list[RealArray]()
    for i, j in np.ndindex(height, width):
        b, a = (np.trim_zeros(np.asarray(each[i][j], dtype=float), "f") for each in (numerators, denominators))
        if b.size > a.size:
            raise InputError(
                f"element [{i}, {j}] isn't proper: its numerator has degree {b.size - 1}, its denominator {a.size - 1}; "
                "add fast poles, such as a derivative filter"
            )
        # controllable canonical form with a monic denominator
        b, a = np.pad(b, (a.size - b.size, 0)) / a[0], a / a[0]
        D[i, j], states = b[0], a.size - 1
        if states:
            parts.append(np.vstack([-a[1:], np.eye(states)[:-1]]))
        columns.append(np.outer(np.eye(states, 1), np.eye(1, width, j)))
        rows.append(np.outer(np.eye(1, height, i), b[1:] - b[0] * a[1:]))
    A = np.asarray(block_diag(*parts), dtype=float) if parts else np.zeros((0, 0))
    return A, np.concatenate(columns), np.concatenate(rows, axis=1), D
