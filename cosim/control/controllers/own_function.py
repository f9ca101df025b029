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
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from flexfmu.cosim.control.controllers.function_controller import FunctionController
from flexfmu.cosim.control.controllers.joints import JOINTS, TORQUE, joint_inputs, joint_outputs
from flexfmu.cosim.control.controllers.named_signals import named_signals
from flexfmu.cosim.engine.errors import InputError

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
    standard = joint_inputs(JOINTS, "reference.position", "reference.velocity", "position", "velocity")
    taken = standard if inputs is None else named_signals(inputs, "input", units)
    given = joint_outputs(JOINTS, *TORQUE) if outputs is None else named_signals(outputs, "output", units)
    states = tuple(float(value) for value in np.atleast_1d(np.asarray(state, dtype=float)))

    def decorate(function: Callable[..., Any]) -> FunctionController:
        own = name or str(getattr(function, "__name__", "controller"))
        return FunctionController(
            function,
            own,
            sample_time,
            offset,
            tuple(taken),
            tuple(given),
            states,
            parameters_of(function, own),
            units,
            symbolic,
        )

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
        found[key] = _tunable(argument.default)
    return found


def _tunable(value: Any) -> Any:
    """A sequence of floats as a tuple; anything else as it is."""
    is_sequence = isinstance(value, (list, tuple, np.ndarray)) and len(value) > 0
    if is_sequence and all(isinstance(each, float) for each in value):
        return tuple(float(each) for each in value)
    return float(value) if isinstance(value, float) else value
