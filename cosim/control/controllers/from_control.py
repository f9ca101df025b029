"""Discrete-time linear systems with named signals and their blocks, also of python-control's systems; continuous ones are discretised."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isclose, pi, tan
from typing import Any, Literal, TypedDict, Unpack, get_args

import casadi
import numpy as np
from scipy.linalg import block_diag
from scipy.signal import cont2discrete

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.joints import check_units
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
def _of_section(s: StateSpaceSection, context: LoopContext) -> SymbolicBlock:
    # without states it is a static gain, whatever stands in B and C
    A, B, C = (s.A, s.B, s.C) if np.size(s.A) else ((), (), ())
    D = np.zeros((len(s.outputs), len(s.inputs))) if s.D is None else s.D
    inputs, outputs = (tuple(map(Signal, names)) for names in (s.inputs, s.outputs))
    matrices = np.array(A), np.array(B), np.array(C), np.array(D)
    return state_space(LinearSystem(*matrices, s.sample_time, inputs, outputs), offset=s.offset)


Method = Literal["zoh", "foh", "tustin", "euler", "backward"]
"""Discretisations: zero-order hold, exact for inputs that are constant between the samples; first-order (triangle)
hold, exact for inputs that are linear between the samples; Tustin's rule; Euler's forward and backward rule. G. F.
Franklin, J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd ed. 1998, chapter 6."""

_SCIPY_NAMES: Mapping[Method, Any] = {
    "zoh": "zoh",
    "foh": "foh",
    "tustin": "bilinear",
    "euler": "euler",
    "backward": "backward_diff",
}

_OBJECT = re.compile(r"^(joint\d+|link\d+|end_effector|force)_")
_QUANTITY = re.compile(r"\.(reference|position|velocity|acceleration)_(position|velocity|acceleration|x|y)$")

SAME_SAMPLE_TIME = 1e-9
"""Relative difference below which two sample times are the same: divisions such as 1 / 4000 are rounded."""


class Conversion(TypedDict, total=False):
    """Keyword arguments of `from_control`."""

    method: Method | None
    sample_time: float | None
    prewarp: float | None
    inputs: Sequence[str] | None
    outputs: Sequence[str] | None
    units: Mapping[str, str]


def control_block(
    system: Any,
    *,
    offset: float = 0.0,
    start: Sequence[float] | None = None,
    name: str = "controller",
    **conversion: Unpack[Conversion],
) -> SymbolicBlock:
    """Build the block of a `control.StateSpace` or `control.TransferFunction`.

    Args:
        system: as for `from_control`.
        offset: first sample instant [s].
        start: start states of a state space (n,); zero when left out.
        name: name of the block.
        conversion: as for `from_control`.

    Raises:
        InputError: as for `from_control`.
    """
    return state_space(from_control(system, **conversion), offset=offset, start=start, name=name)


def from_control(
    system: Any,
    *,
    method: Method | None = None,
    sample_time: float | None = None,
    prewarp: float | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
) -> LinearSystem:
    """Return the discrete-time system of a `control.StateSpace` or `control.TransferFunction`.

    It may have any number of inputs and outputs. A discrete system keeps its matrices and its sample time. A continuous
    one needs a method and a sample time. Labels become names; python-control allows no dots in them, so `dotted`
    restores the dots of the robot's variables.

    Args:
        system: the system.
        method: discretisation of a continuous system, see `Method`.
        sample_time: [s] of a continuous system, or of a discrete one whose ``dt`` is True.
        prewarp: frequency [rad/s] at which Tustin's rule is exact; for that method only.
        inputs, outputs: names that replace the labels.
        units: name → unit; a signal without a unit connects to any unit.

    Raises:
        InputError: the system is of another kind or not proper, it has no time base,
            it is continuous without method or sample time, sample times contradict each other, or a name is unknown.
    """
    # matrices and names of the system
    matrices, units = _matrices(system), units or {}
    names_in = _names(inputs, system.input_labels, "inputs")
    names_out = _names(outputs, system.output_labels, "outputs")
    check_units(units, [*names_in, *names_out], "linear system")
    dt = system.dt
    if dt is None:
        raise InputError("the system has no time base (dt is None); set dt = 0 for continuous, or its sample time in s")
    if system.isctime(strict=True):
        # neither method nor sample time has a default
        if method is None or sample_time is None:
            raise InputError(
                f"the system is continuous: say how to discretise it, method= one of {', '.join(get_args(Method))}, "
                "and with which sample_time= in s; or discretise it with control.c2d"
            )
        if method not in get_args(Method):
            raise InputError(f"unknown method {method!r}; choose from {', '.join(get_args(Method))}")
        check_sampling(sample_time, 0.0, "the system")
        matrices = _discretise(matrices, method, sample_time, prewarp)
    else:
        if method is not None or prewarp is not None:
            raise InputError("the system is discrete and is taken as it is; leave out method and prewarp")
        # its own sample time, or the argument where its dt is True
        if dt is True and sample_time is None:
            raise InputError("the system is discrete without a sample time (dt is True); say sample_time= in s")
        if dt is not True and sample_time is not None and not isclose(dt, sample_time, rel_tol=SAME_SAMPLE_TIME):
            raise InputError(
                f"the system has the sample time {dt} s, not {sample_time} s; leave out sample_time, or design it anew"
            )
        sample_time = sample_time if dt is True and sample_time is not None else float(dt)
    # a signal without a unit connects to any unit
    signals_in, signals_out = (
        tuple(Signal(name, units.get(name, "1")) for name in names) for names in (names_in, names_out)
    )
    return LinearSystem(*matrices, sample_time, signals_in, signals_out)


def dotted(label: str) -> str:
    """Restore the dots in a variable's name that `flexfmu.model.linear` replaced by underscores.

    ``joint1_torque`` → ``joint1.torque``, ``end_effector_position_x`` → ``end_effector.position.x``. Other labels stay
    as they are.
    """
    return _QUANTITY.sub(r".\1.\2", _OBJECT.sub(r"\1.", label))


def _matrices(system: Any) -> Matrices:
    """Return A, B, C, D of a system in s or z.

    Raises:
        InputError: the system is of another kind or not proper.
    """
    import control

    if isinstance(system, control.StateSpace):
        return system.A, system.B, system.C, system.D
    # transfer functions need a realisation
    if isinstance(system, control.TransferFunction):
        return realise(system.num_array, system.den_array)
    raise InputError(
        f"need a control.StateSpace or control.TransferFunction, got {type(system).__name__}; convert it with control.ss"
    )


def _names(given: Sequence[str] | None, labels: Sequence[str], what: str) -> list[str]:
    """Return the names that replace the labels, or the labels with their dots."""
    if given is None:
        return [dotted(label) for label in labels]
    if isinstance(given, str) or len(given) != len(labels):
        raise InputError(
            f"{what} must be a sequence of {len(labels)} names, one for each of {list(labels)}, got {given!r}"
        )
    return list(given)


def _discretise(matrices: Any, method: Method, sample_time: float, prewarp: float | None) -> Matrices:
    """Return A, B, C, D of the discrete equivalent of a continuous system."""
    # prewarping: Tustin's rule with another step
    step = sample_time
    if prewarp is not None:
        if method != "tustin":
            raise InputError(f"prewarp belongs to the method 'tustin', not to {method!r}")
        if not 0.0 < prewarp < pi / sample_time:
            raise InputError(
                f"prewarp must be above 0 and below the Nyquist frequency {pi / sample_time:.6g} rad/s, got {prewarp} rad/s"
            )
        step = 2.0 * tan(prewarp * sample_time / 2.0) / prewarp
    # a static gain needs no discretisation
    if np.size(matrices[0]) == 0:
        return matrices[0], matrices[1], matrices[2], matrices[3]
    A, B, C, D, _ = cont2discrete(matrices, step, _SCIPY_NAMES[method])
    return np.asarray(A), np.asarray(B), np.asarray(C), np.asarray(D)


Matrices = tuple[RealArray, RealArray, RealArray, RealArray]
"""A (n, n), B (n, inputs), C (outputs, n), D (outputs, inputs)."""


def realise(numerators: Sequence[Sequence[RealArray]], denominators: Sequence[Sequence[RealArray]]) -> Matrices:
    """Return a state space of a matrix of transfer functions in s or z.

    Every element is realised in its own controllable canonical form (T. Kailath, Linear Systems, 1980, section 2.1.1).
    The realisation isn't minimal where elements share poles; the response is the same.

    Args:
        numerators, denominators: [output][input] → coefficients, highest power first.

    Raises:
        InputError: an element isn't proper, its denominator is zero, or a coefficient isn't finite.
    """
    height, width = len(numerators), len(numerators[0])
    D = np.zeros((height, width))
    # states, input column and output row of every element
    parts: list[RealArray] = []
    rows: list[RealArray] = []
    columns: list[RealArray] = []
    for i in range(height):
        for j in range(width):
            a, c, D[i, j] = _canonical(numerators[i][j], denominators[i][j], f"[{i}, {j}]")
            if a.size:
                parts.append(a)
            columns.append(np.outer(np.eye(len(a), 1), np.eye(1, width, j)))
            rows.append(np.outer(np.eye(1, height, i), c))
    A = np.asarray(block_diag(*parts), dtype=float) if parts else np.zeros((0, 0))
    return A, np.concatenate(columns), np.concatenate(rows, axis=1), D


def _canonical(numerator: RealArray, denominator: RealArray, where: str) -> tuple[RealArray, RealArray, float]:
    """Return A, C, D of one element; B is the first unit vector.

    Raises:
        InputError: the element isn't proper, its denominator is zero, or a coefficient isn't finite.
    """
    b, a = (np.trim_zeros(np.asarray(each, dtype=float), "f") for each in (numerator, denominator))
    if not (np.isfinite(b).all() and np.isfinite(a).all()):
        raise InputError(f"the coefficients of element {where} must be finite, got {numerator} / {denominator}")
    if a.size == 0:
        raise InputError(f"the denominator of element {where} is zero")
    if b.size > a.size:
        raise InputError(
            f"element {where} isn't proper: its numerator has degree {b.size - 1}, its denominator {a.size - 1}; "
            "add fast poles, such as a derivative filter"
        )
    # controllable canonical form with a monic denominator
    b = np.concatenate([np.zeros(a.size - b.size), b]) / a[0]
    a = a / a[0]
    A = np.eye(a.size - 1, k=-1)
    A[:1] = -a[1:]
    return A, b[1:] - b[0] * a[1:], float(b[0])
