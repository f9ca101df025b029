"""A controller from a Python function u = f(t, reference, measurement, state) and a decorator that names its signals.

    @flexfmu.controller(sample_time=1e-3)
    def springs(reference, measurement, *, stiffness=1e4, damping=100.0):
        error = reference - measurement
        return stiffness * error[:2] + damping * error[2:]

A function that is written with operations that CasADi knows becomes a `SymbolicBlock`, which runs in C and leaves as an FMU; any
other stays a slave in Python. Whether it does is tried when the slave is made: the function is called with symbols once, then with
numbers, and both must agree.
"""

from __future__ import annotations

import inspect
import os
import re
import traceback
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.blocks.slave import BlockSlave, SampledMemory
from flexfmu.cosim.control.controllers import joints
from flexfmu.cosim.engine.errors import InputError, SlaveError, suggestion
from flexfmu.cosim.engine.slave import RealArray, check_sampling
from flexfmu.model.symbolic import SymbolicBlock, Variable

ARGUMENTS = ("t", "reference", "measurement", "state")
"""Arguments that a function may have, beside its parameters."""


def controller(
    *,
    sample_time: float,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    state: Sequence[float] | float = (),
    offset: float = 0.0,
    units: Mapping[str, str] | None = None,
    name: str | None = None,
    symbolic: bool | None = None,
) -> Callable[[Callable[..., Any]], FunctionController]:
    """Return a decorator that makes a controller of a function; it runs in `flexfmu.cosim.many.prepared_scene.run_loop`, and in scene
    files as ``kind = "python"``.

    The function has any of these arguments: ``t``, the instant of the sample [s], counted from the start; ``reference``, the inputs
    with ``.reference.`` in their names; ``measurement``, the other inputs; ``state``; each a vector in the order of the names. It
    returns the outputs, and with a state the pair outputs, next state. Its other arguments need defaults: floats, and tuples of
    floats, are tunable parameters; anything else is a constant. It must not keep anything between calls.

    Args:
        sample_time: [s].
        inputs: names of signals; by default the reference positions and velocities of both joints, then the measured ones.
        outputs: names of signals; by default the torques of both joints.
        state: start values.
        offset: first sample instant [s].
        units: name → unit of signals and parameters that aren't the robot's.
        name: name of the slave; by default the function's.
        symbolic: True requires a `SymbolicBlock`, False a slave in Python without trial calls, None takes what is possible.

    Raises:
        InputError: an argument has no default, a name is repeated, a number isn't finite, or the sample time isn't positive.
    """
    units = units or {}
    standard = joints.joint_inputs("reference.position", "reference.velocity", "position", "velocity")
    taken = standard if inputs is None else joints.named_signals(inputs, "input", units)
    given = joints.joint_outputs(*joints.TORQUE) if outputs is None else joints.named_signals(outputs, "output", units)
    states = tuple(float(value) for value in np.atleast_1d(np.asarray(state, dtype=float)))

    def decorate(function: Callable[..., Any]) -> FunctionController:
        own = name or str(getattr(function, "__name__", "controller"))
        signals, parameters = (tuple(taken), tuple(given)), parameters_of(function, own)
        return FunctionController(function, own, sample_time, offset, *signals, states, parameters, units, symbolic)

    return decorate


def parameters_of(function: Callable[..., Any], name: str) -> dict[str, Any]:
    """The arguments of a function beside `ARGUMENTS`, with their defaults.

    Raises:
        InputError: one has no default.
    """
    found = {}
    for key, argument in inspect.signature(function).parameters.items():
        if key in ARGUMENTS or argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
            continue
        if argument.default is argument.empty:
            raise InputError(
                f"{name} has the argument {key!r} without a default: the arguments are {', '.join(ARGUMENTS)}, and parameters such as "
                f"{key}=1.0"
            )
        # a sequence of floats as a tuple; anything else as it is
        value = argument.default
        if isinstance(value, (list, tuple, np.ndarray)) and all(isinstance(each, float) for each in value):
            value = tuple(map(float, value)) if len(value) else value
        found[key] = float(value) if isinstance(value, float) else value
    return found


REFERENCE = ".reference."
"""Part of the names of inputs that belong to ``reference``."""

TRIALS = 8
"""Sets of arguments with which the traced function is compared; the first has the start values."""

AGREEMENT = 1e-9
"""Relative difference from which traced and called function differ: NumPy and CasADi round elementary functions differently."""

SYMBOLS = (casadi.SX, casadi.MX)
"""Types of CasADi's symbols."""


def as_elements(column: Vector) -> Any:
    """The elements of a column of symbols as an array."""
    found = np.empty(column.numel(), dtype=object)
    found[:] = casadi.vertsplit(column)
    return found


KINDS: tuple[tuple[Any, Callable[[Vector], Any]], ...] = (
    (casadi.SX, lambda column: column),
    (casadi.SX, as_elements),
    (casadi.MX, lambda column: column),
)
"""Symbols with which functions are traced: columns for those of vectors, arrays for those that take elements one by one, and matrix
expressions for those that call CasADi's functions, as of tables."""


class NotSymbolicError(InputError):
    """CasADi can't trace a function."""


@dataclass(frozen=True, eq=False)
class FunctionController:
    """A function as a sampled controller; calling it calls the function.

    Attributes:
        function: the function.
        name: name of the slave.
        sample_time, offset: [s].
        inputs, outputs: variables in their order.
        states: start values.
        parameters: keyword arguments of the function: floats and sequences of floats are tunable, others constants.
        units: name → unit.
        symbolic: True requires a `SymbolicBlock`, False a slave in Python without trial calls, None takes what is possible.
    """

    function: Callable[..., Any]
    name: str
    sample_time: float
    offset: float
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[float, ...]
    parameters: Mapping[str, Any]
    units: Mapping[str, str]
    symbolic: bool | None = None

    def __post_init__(self) -> None:
        check_sampling(self.sample_time, self.offset, self.name)
        joints.check_units(
            self.units, [each.name for each in (*self.inputs, *self.outputs, *self.variables)], self.name
        )

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        return self.function(*arguments, **keywords)

    @property
    def variables(self) -> list[Variable]:
        """The tunable parameters; the elements of a sequence are ``name[1]``, ``name[2]`` and so on."""
        values: dict[str, float] = {}
        for name, value in self.parameters.items():
            if isinstance(value, float):
                values[name] = value
            elif is_vector(value):
                values |= {f"{name}[{i}]": element for i, element in enumerate(value, start=1)}
        return joints.named_parameters(values, self.units)

    @property
    def symbolic_block(self) -> SymbolicBlock:
        """The function as a block.

        Raises:
            NotSymbolicError: CasADi can't trace it.
            InputError: the function fails, or returns wrong numbers of values.
        """
        return function_block(self)

    def changed(self, arguments: Mapping[str, Any]) -> FunctionController:
        """Return the controller with other parameters, sample time or offset.

        Raises:
            InputError: the function has no such parameter, or a value is of another kind than the default.
        """
        parameters: dict[str, Any] = dict(self.parameters)
        timing: dict[str, Any] = {}
        for name, value in arguments.items():
            if name in parameters:
                parameters[name] = like(parameters[name], value, f"{self.name}: {name}")
            elif name in ("sample_time", "offset"):
                timing[name] = like(0.0, value, f"{self.name}: {name}")
            else:
                known = [*parameters, "sample_time", "offset"]
                hint = suggestion(name, known)
                raise InputError(f"{self.name} has no parameter {name!r}; {hint}")
        return replace(self, parameters=parameters, **timing)

    def slave(self, name: str = "") -> BlockSlave | FunctionSlave:
        """Return the slave: of the block where CasADi can trace the function, else in Python.

        Raises:
            InputError: the function fails, returns wrong numbers of values, or depends on more than its arguments.
        """
        reason = "symbolic = False"
        if self.symbolic is not False:
            try:
                return BlockSlave(function_block(self), name)
            except NotSymbolicError as error:
                if self.symbolic:
                    raise
                reason = str(error)
        return FunctionSlave(self, name or self.name, reason)

    def trials(self) -> list[tuple[RealArray, ...]]:
        """Arguments x, u, p and results y, next x of calls with numbers.

        Raises:
            InputError: every call fails, or a call repeated gives other values.
        """
        random = np.random.default_rng(0)
        start, gains = np.array([*self.states, 0.0]), np.array([each.start for each in self.variables], dtype=float)
        found: list[tuple[RealArray, ...]] = []
        failure: Exception | None = None
        for k in range(TRIALS):
            x = start + np.append(random.normal(size=len(self.states)), 1.0) * k
            u = random.normal(size=len(self.inputs)) * k
            try:
                with np.errstate(all="ignore"):
                    found.append((x, u, gains, *self.called(x.copy(), u.copy(), gains.copy())))
            except InputError:
                raise
            except Exception as error:
                failure = error
        if not found:
            raise InputError(f"{self.name} fails: {described(failure)}") from failure
        # the first call again
        x, u, p, *first = found[0]
        if not all(
            np.array_equal(a, b, equal_nan=True)
            for a, b in zip(first, self.called(x.copy(), u.copy(), p.copy()), strict=True)
        ):
            raise InputError(
                f"{self.name} gives other values for the same arguments: what it keeps between calls must be its `state`, so that "
                "samples can be repeated; or say symbolic=False, and it is called at samples only"
            )
        return found

    def called(self, x: Any, u: Any, p: Any) -> tuple[Any, Any]:
        """Outputs and next states, both flat, from states with the counter, inputs and parameters: numbers or symbols.

        Raises:
            InputError: the function returns a wrong number of values.
        """
        wanted, references, others = self._arguments
        given: dict[str, Any] = {}
        if "t" in wanted:
            given["t"] = self.offset + x[-1] * self.sample_time
        if "reference" in wanted:
            given["reference"] = u[references]
        if "measurement" in wanted:
            given["measurement"] = u[others]
        if "state" in wanted:
            given["state"] = x[:-1]
        result = self.function(**given, **self._with_values(p))
        if not self.states:
            return self._flat(result, len(self.outputs), "outputs"), as_column([])
        if not isinstance(result, tuple) or len(result) != 2:
            instead = "; it returns None" if result is None else ""
            raise InputError(f"{self.name} has states and must return two things: outputs, next states{instead}")
        return (self._flat(result[0], len(self.outputs), "outputs"), self._flat(result[1], len(self.states), "states"))

    @cached_property
    def _arguments(self) -> tuple[Collection[str], list[int], list[int]]:
        """Names of the function's arguments, and indices of the inputs that are references and of the others."""
        names = [each.name for each in self.inputs]
        references = [i for i, name in enumerate(names) if REFERENCE in name]
        others = [i for i, name in enumerate(names) if REFERENCE not in name]
        return inspect.signature(self.function).parameters, references, others

    def _with_values(self, p: Any) -> dict[str, Any]:
        """The keyword arguments, tunable ones with values from p."""
        values, at = dict(self.parameters), 0
        for name, value in self.parameters.items():
            if isinstance(value, float):
                values[name], at = p[at], at + 1
            elif is_vector(value):
                values[name], at = p[at : at + len(value)], at + len(value)
        return values

    def _flat(self, values: Any, count: int, what: str) -> Any:
        # NumPy would take None for NaN
        if values is None or (isinstance(values, (list, tuple)) and any(each is None for each in values)):
            raise InputError(
                f"{self.name} returns None {'for' if values is None else 'among'} its {count} {what}: every way through it must end "
                "with `return` and numbers"
            )
        column = as_column(values)
        size = column.numel() if isinstance(column, SYMBOLS) else column.size
        if size != count:
            raise InputError(f"{self.name} returns {size} values for its {count} {what}")
        return column


def function_block(controller: FunctionController) -> SymbolicBlock:
    """Return the block of a function, traced with CasADi's symbols and compared with calls.

    Raises:
        NotSymbolicError: CasADi can't trace it; it may still be a slave in Python.
        InputError: the function fails, returns wrong numbers of values, or depends on more than its arguments.
    """
    trials, reasons = controller.trials(), []
    for symbol, kind in KINDS:
        try:
            made = _traced(controller, symbol, kind)
            _compare(made, trials)
            return made
        except NotSymbolicError as error:
            reasons.append(error)
    raise reasons[0]


def _traced(controller: FunctionController, symbol: Any, kind: Callable[[Vector], Any]) -> SymbolicBlock:
    """The block from one call with symbols of a kind; its last state counts the samples if the function takes the time."""
    counter = [0.0] if "t" in inspect.signature(controller.function).parameters else []

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        x = x if counter else casadi.vertcat(x, 0.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # CasADi's, on functions of NumPy
            try:
                y, following = (symbol(each) for each in controller.called(kind(x), kind(u), kind(p)))
            except Exception as error:
                reason = f"{controller.name}: CasADi can't trace the function: {described(error)}"
                raise NotSymbolicError(reason) from error
        return y, casadi.vertcat(following, x[-1] + 1.0) if counter else following

    return block(
        controller.name,
        (inspect.getdoc(controller.function) or f"The function {controller.name}").partition("\n")[0],
        equations,
        sample_time=controller.sample_time,
        offset=controller.offset,
        inputs=controller.inputs,
        outputs=controller.outputs,
        parameters=controller.variables,
        states=[*controller.states, *counter],
        symbol=symbol,
    )


def _compare(made: SymbolicBlock, trials: Sequence[tuple[RealArray, ...]]) -> None:
    """Compare a block with calls of its function.

    Raises:
        NotSymbolicError: values differ.
    """
    for x, u, p, y, following in trials:
        states = x[: len(made.states)]
        traced = casadi.vertcat(made.output(states, u, p), made.update(states, u, p)).full()[:, 0]
        counter = [x[-1] + 1.0] if len(made.states) > len(following) else []
        called = np.concatenate([y, following, counter])
        if not np.allclose(traced, called, rtol=AGREEMENT, atol=AGREEMENT, equal_nan=True):
            raise NotSymbolicError(
                f"{made.name}: with CasADi's symbols the function calculates other values than with numbers"
            )


def as_column(values: Any) -> Any:
    """Nested sequences, arrays, numbers and symbols as one column of symbols, or one array of floats."""
    if isinstance(values, np.ndarray) and values.dtype == float:
        return values.ravel()
    pieces = list(_pieces(values))
    if any(isinstance(each, SYMBOLS) for each in pieces):
        return casadi.vertcat(*pieces)
    return np.concatenate([np.ravel(np.asarray(each, dtype=float)) for each in pieces]) if pieces else np.zeros(0)


def _pieces(values: Any) -> Iterable[Any]:
    """The numbers, arrays of numbers and symbols in nested sequences."""
    if isinstance(values, SYMBOLS):
        yield casadi.vec(values)
    elif isinstance(values, (list, tuple)) or (isinstance(values, np.ndarray) and values.dtype == object):
        for each in np.ravel(values) if isinstance(values, np.ndarray) else values:
            yield from _pieces(each)
    else:
        yield values.full() if isinstance(values, casadi.DM) else values


def is_vector(value: Any) -> bool:
    """Whether a default is a tuple of floats, each of which is a tunable parameter."""
    return isinstance(value, tuple) and len(value) > 0 and all(isinstance(each, float) for each in value)


def like(default: Any, value: Any, where: str) -> Any:
    """The value, as a float or a tuple of floats where the default is one.

    Raises:
        InputError: it can't be.
    """
    try:
        if isinstance(default, float):
            return float(value)
        if is_vector(default):
            found = tuple(float(each) for each in value)
            if len(found) == len(default):
                return found
            raise ValueError
    except (TypeError, ValueError):
        what = "a number" if isinstance(default, float) else f"{len(default)} numbers"
        raise InputError(f"{where} must be {what}, got {value!r}") from None
    return value


class FunctionSlave(SampledMemory):
    """Calls a function (states with the counter of samples, inputs, parameters) → (outputs, next states) at its instants.

    Args:
        controller: the function, its variables and start values.
        name: name of the slave.
        reason: why it isn't a block.

    Attributes:
        has_foreign_code: True, as the function is the user's.
    """

    has_foreign_code = True

    def __init__(self, controller: FunctionController, name: str, reason: str) -> None:
        own, states = controller, [*controller.states, 0.0]
        super().__init__(name, own.inputs, own.variables, own.outputs, states=len(states))
        self.reason, self.sample_time, self.offset = reason, own.sample_time, own.offset
        # the last state counts the samples
        self._function, self._start, self._end = own.called, np.array(states), len(self.variables)

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Set the start states and calculate the outputs."""
        self._memory[self._end :] = self._start
        self._calculate(start_time)

    def sample(self, time: float) -> None:
        """Calculate outputs and next states from the inputs just set.

        Raises:
            SlaveError: the function fails, or a value isn't finite.
        """
        following = self._calculate(time)
        self._memory[self._end : -1] = following
        self._memory[-1] += 1.0

    def _calculate(self, time: float) -> RealArray:
        """Set the outputs and return the next states."""
        # copies, so that the function can't change what it gets
        values = self._memory.copy()
        inputs, parameters, states = values[: self._inputs], values[self._inputs : self._known], values[self._end :]
        try:
            outputs, following = self._function(states, inputs, parameters)
        except Exception as error:
            raise SlaveError(self.name, described(error), time) from error
        if not (np.isfinite(outputs).all() and np.isfinite(following).all()):
            names = [each.name for each in self.variables[self._known :]]
            wrong = [name for name, value in zip(names, outputs, strict=True) if not np.isfinite(value)]
            raise SlaveError(self.name, f"{wrong[0] if wrong else 'the next state'} isn't finite", time)
        self._memory[self._known : self._end] = outputs
        next_states: RealArray = following
        return next_states


def described(error: BaseException | None) -> str:
    """Type and first line of an error, and the last line of the user's code on the way to it; of our own errors the sentence."""
    if isinstance(error, InputError):
        return str(error)
    frames = traceback.extract_tb(error.__traceback__) if error else []
    rooms = (f"{Path(__file__).parents[3]}{os.sep}{room}{os.sep}" for room in ("cosim", "fmu_build", "model", "src"))
    others = "/casadi/", "/numpy/", "/importlib/", "<frozen ", *rooms
    own = [each for each in frames if not any(name in each.filename for name in others)]
    where = f" ({own[-1].filename}, line {own[-1].lineno})" if own else ""
    lines = [re.sub(r"^\S*\.cpp:\d+: ", "", line) for line in str(error).splitlines() if line.strip()]
    kind = "" if type(error).__module__.startswith("flexfmu.") else f"{type(error).__name__}: "
    return f"{kind}{lines[0] if lines else ''}{where}"
