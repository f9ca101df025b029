"""The parameters of a controller's Python function: its arguments with defaults."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from flexfmu.cosim.engine.errors import InputError

ARGUMENTS = ("t", "reference", "measurement", "state")
"""Arguments that a function may have, beside its parameters."""


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
