"""Variables of an FMU as slave variables, with their value references, and start values with their checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import isclose
from numbers import Real
from sys import float_info
from typing import Any, Literal, cast

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import TEXTS, Causality, SlaveVariable

FmiType = Literal["Real", "Integer", "Boolean", "String"]
"""Type in the names of the FMI functions that transfer a variable; enumerations use those of Integer."""

Value = float | int | bool | str
"""Value of a parameter; for an enumeration or a numbered choice also the item's name."""


_BOOLEANS = {"true": True, "false": False}
"""Booleans as FMI spells them."""

ROUNDING = 1e-12
"""Relative tolerance of values read back: an FMU that converts units may round them a few times."""


@dataclass(frozen=True)
class Handle:
    """Address of a variable for the FMI functions: type of the functions and value reference."""

    kind: FmiType
    reference: int


@dataclass(frozen=True)
class FmuVariables:
    """Variables of a model description.

    Attributes:
        connectable: inputs, outputs and numeric parameters, in the order of the model description.
        handles: handle of each of them.
        others: name → handle of all other variables.
        feedthrough: output → inputs that it depends on at the same instant; outputs without stated dependencies are
            left out.
    """

    connectable: tuple[SlaveVariable, ...]
    handles: tuple[Handle, ...]
    others: Mapping[str, Handle]
    feedthrough: Mapping[str, tuple[str, ...]]


def read_variables(description: Any) -> FmuVariables:
    """Return the variables of a model description read by fmpy."""
    connectable = [
        v
        for v in description.modelVariables
        if v.causality in ("input", "output") or (v.causality == "parameter" and v.type != "String")
    ]
    # of all others only statistics are read
    names = {v.name for v in connectable}
    others = {v.name: _handle(v) for v in description.modelVariables if v.name not in names}
    inputs = {v.name for v in connectable if v.causality == "input"}
    # direct feedthrough, where stated
    depends = {
        unknown.variable.name: tuple(v.name for v in unknown.dependencies if v.name in inputs)
        for unknown in description.outputs
        if unknown.dependencies is not None
    }
    return FmuVariables(tuple(map(_variable, connectable)), tuple(map(_handle, connectable)), others, depends)


def _variable(variable: Any) -> SlaveVariable:
    """Return the variable for the master."""
    text = variable.type == "String"
    start = None if variable.start is None else TEXTS.code(variable.start) if text else _number(variable.start)
    discrete = variable.type != "Real" or variable.variability == "discrete"
    return SlaveVariable(
        variable.name, cast(Causality, variable.causality), _unit(variable), start, discrete, variable.type
    )


def _number(text: str) -> float:
    """Return a start value as a number; booleans may be true and false or 1 and 0."""
    return float({"true": 1.0, "false": 0.0}.get(text, text))


def _handle(variable: Any) -> Handle:
    """Return the handle of the variable; variables of FMI 3.0 have their own."""
    return getattr(variable, "handle", None) or Handle(
        "Integer" if variable.type == "Enumeration" else variable.type, variable.valueReference
    )


def parameter_names(description: Any) -> frozenset[str]:
    """Return the names of all parameters."""
    return frozenset(v.name for v in description.modelVariables if v.causality == "parameter")


@dataclass(frozen=True)
class Setting:
    """A start value.

    Attributes:
        name, handle: name and handle of the variable.
        value: start value.
        lasting: whether the value holds after initialisation and may be set in initialisation mode; False for a guess
            (initial = approx).
    """

    name: str
    handle: Handle
    value: Value
    lasting: bool = True


def settable_variables(description: Any) -> Mapping[str, Any]:
    """Return name → fmpy's variable for all that may be set before initialisation (FMI 2.0.4, section 2.2.7)."""
    return {
        v.name: v
        for v in description.modelVariables
        if v.causality in ("parameter", "input") or (v.initial in ("exact", "approx") and v.variability != "constant")
    }


def settings(known: Mapping[str, Any], parameters: Mapping[str, Value]) -> Sequence[Setting]:
    """Return start values for parameters by name, with names of items replaced by their numbers.

    Args:
        known: variables from `settable_variables`.
        parameters: name → value.

    Raises:
        InputError: a parameter doesn't exist, or its value doesn't fit its type or range.
    """
    result = []
    for name, value in parameters.items():
        if name not in known:
            # suggest the closest name, or list all parameters
            near = get_close_matches(name, known, n=1)
            names = ", ".join(name for name, v in known.items() if v.causality == "parameter") or "none"
            remedy = f"did you mean {near[0]!r}?" if near else f"it has: {names}"
            raise InputError(f"the FMU has no parameter {name!r}; {remedy}")
        variable = known[name]
        lasting = variable.initial != "approx"
        result.append(Setting(name, _handle(variable), _in_range(variable, typed(variable, value)), lasting))
    return result


def _number_for(variable: Any, value: Value) -> Value:
    """Return the value if it is a number that fits the variable's type; raise `InputError` otherwise."""
    if not isinstance(value, Real):
        raise InputError(f"{variable.name} must be one number, got {value!r}")
    if variable.type == "Boolean" and value not in (0, 1):
        raise InputError(f"{variable.name} must be true or false, got {value}")
    if variable.type != "Real" and value % 1 != 0:
        raise InputError(f"{variable.name} must be a whole number, got {value}")
    # an enumeration: the number of an item
    known = items(variable) if variable.type == "Enumeration" else {}
    if known and value not in known.values():
        names = ", ".join(f"{number} ({name})" for name, number in known.items())
        raise InputError(f"{variable.name} must be one of {names}, got {value}")
    return value


def items(variable: Any) -> dict[str, int]:
    """Return the items of an enumeration or numbered choice (name → number); empty for other variables."""
    declared = variable.declaredType
    return {item.name: int(item.value) for item in declared.items or ()} if declared else {}


def _in_range(variable: Any, value: Value) -> Value:
    """Return the value if it is within the variable's range; raise `InputError` otherwise."""
    if variable.type not in ("Real", "Integer") or isinstance(value, str):
        return value
    # limits of the variable, or of its declared type
    low, high = (_bound(variable, bound) for bound in ("min", "max"))
    if (low is None or value >= low) and (high is None or value <= high) and abs(value) <= float_info.max:
        return value
    # otherwise state the possible values
    unit = _unit(variable)
    unit = "" if unit in ("", "1") else f" {unit}"
    limits = [f"at least {low:g}{unit}"] if low is not None else []
    limits += [f"at most {high:g}{unit}"] if high is not None else []
    raise InputError(f"{variable.name} must be {' and '.join(limits) or 'a finite number'}, got {value}{unit}")


def _bound(variable: Any, name: str) -> float | None:
    """Return a limit of the variable, or else of its declared type; None if neither has one."""
    for holder in (variable, variable.declaredType):
        text = getattr(holder, name, None)
        if text is not None:
            return float(text)
    return None


def _unit(variable: Any) -> str:
    """Return the unit of the variable or of its declared type; empty if unknown."""
    return variable.unit or (variable.declaredType.unit if variable.declaredType else None) or ""


def typed(variable: Any, value: Value) -> Value:
    """Return the value in the variable's type; names of items become numbers.

    Raises:
        InputError: the value doesn't fit the type: not a number, not whole, not 0 or 1, or not an item.
    """
    if variable.type == "String":
        return str(value)
    if variable.type == "Boolean" and isinstance(value, str) and value in _BOOLEANS:
        return _BOOLEANS[value]
    if not isinstance(value, str):
        return _number_for(variable, value)
    # the name of an item
    known = items(variable)
    if not known:
        raise InputError(f"{variable.name} is a number, got {value!r}")
    if value not in known:
        raise InputError(f"{variable.name} must be one of {', '.join(known)}, got {value!r}")
    return known[value]


def in_words(variable: Any, value: Value) -> str:
    """Return a value of the variable for messages, with its unit or as the name of its item."""
    if variable.type == "String":
        return repr(value)
    if variable.type == "Boolean":
        return "true" if value else "false"
    name = next((name for name, number in items(variable).items() if number == value), None)
    if name is not None:
        return f"{name!r}"
    unit = _unit(variable)
    return f"{value:.12g}" + (f" {unit}" if unit not in ("", "1") else "")


def same(value: Value, found: Value) -> bool:
    """Return whether two values of a variable agree, except for rounding."""
    if isinstance(value, str) or isinstance(found, str):
        return value == found
    return isclose(value, found, rel_tol=ROUNDING, abs_tol=0.0)
