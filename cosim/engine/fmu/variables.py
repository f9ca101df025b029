"""Variables of an FMU as slaves show them, with what the FMI functions need to reach them."""

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
"""Which family of FMI functions reaches a variable; enumerations are reached like integers."""

Value = float | int | bool | str
"""Value of a parameter; the item's name will do for an enumeration or a numbered choice."""


_BOOLEANS = {"true": True, "false": False}
"""As FMI spells them."""

ROUNDING = 1e-12
"""Relative; FMUs that convert units on the way may give back what they were given with a few roundings."""


@dataclass(frozen=True)
class Handle:
    """How the FMI functions reach a variable."""

    kind: FmiType
    reference: int


@dataclass(frozen=True)
class FmuVariables:
    """All that a model description says about variables.

    Attributes:
        connectable: inputs, outputs and numeric parameters, in the order of the model description.
        handles: how to reach each of them.
        others: name → handle of all further variables (locals).
        feedthrough: output → inputs that it depends on at the same instant; outputs without a statement are left out.
    """

    connectable: tuple[SlaveVariable, ...]
    handles: tuple[Handle, ...]
    others: Mapping[str, Handle]
    feedthrough: Mapping[str, tuple[str, ...]]


def read_variables(description: Any) -> FmuVariables:
    """Sort the variables of a model description that fmpy has read."""
    connectable = [
        v
        for v in description.modelVariables
        if v.causality in ("input", "output") or (v.causality == "parameter" and v.type != "String")
    ]
    # all others are read for statistics alone
    names = {v.name for v in connectable}
    others = {v.name: _handle(v) for v in description.modelVariables if v.name not in names}
    inputs = {v.name for v in connectable if v.causality == "input"}
    # direct feedthrough, as far as it is stated
    depends = {
        unknown.variable.name: tuple(v.name for v in unknown.dependencies if v.name in inputs)
        for unknown in description.outputs
        if unknown.dependencies is not None
    }
    return FmuVariables(tuple(map(_variable, connectable)), tuple(map(_handle, connectable)), others, depends)


def _variable(variable: Any) -> SlaveVariable:
    """The variable as the master sees it."""
    text = variable.type == "String"
    start = None if variable.start is None else TEXTS.code(variable.start) if text else _number(variable.start)
    discrete = variable.type != "Real" or variable.variability == "discrete"
    return SlaveVariable(
        variable.name, cast(Causality, variable.causality), _unit(variable), start, discrete, variable.type
    )


def _number(text: str) -> float:
    """A start value; booleans are spelt in two ways."""
    return float({"true": 1.0, "false": 0.0}.get(text, text))


def _handle(variable: Any) -> Handle:
    """How to reach the variable; elements of arrays know."""
    return getattr(variable, "handle", None) or Handle(
        "Integer" if variable.type == "Enumeration" else variable.type, variable.valueReference
    )


def parameter_names(description: Any) -> frozenset[str]:
    """Names of all parameters."""
    return frozenset(v.name for v in description.modelVariables if v.causality == "parameter")


@dataclass(frozen=True)
class Setting:
    """A start value.

    Attributes:
        name, handle: of the variable.
        value: what it shall be.
        lasting: whether it is still that after initialisation, and may be set in initialisation mode: not a mere guess.
    """

    name: str
    handle: Handle
    value: Value
    lasting: bool = True


def settable_variables(description: Any) -> Mapping[str, Any]:
    """Name → what fmpy has read of each variable that may be set before initialisation (FMI 2.0.4, section 2.2.7)."""
    return {
        v.name: v
        for v in description.modelVariables
        if v.causality in ("parameter", "input") or (v.initial in ("exact", "approx") and v.variability != "constant")
    }


def settings(known: Mapping[str, Any], parameters: Mapping[str, Value]) -> Sequence[Setting]:
    """Look up parameters by name and translate the names of numbered values.

    Args:
        known: see `settable_variables`.
        parameters: name → value.

    Raises:
        InputError: there is no such parameter, or the value doesn't suit its type or range.
    """
    result = []
    for name, value in parameters.items():
        if name not in known:
            # the name that may have been meant, or all parameters
            near = get_close_matches(name, known, n=1)
            names = ", ".join(name for name, v in known.items() if v.causality == "parameter") or "none"
            remedy = f"did you mean {near[0]!r}?" if near else f"it has: {names}"
            raise InputError(f"the FMU has no parameter {name!r}; {remedy}")
        variable = known[name]
        lasting = variable.initial != "approx"
        result.append(Setting(name, _handle(variable), _in_range(variable, typed(variable, value)), lasting))
    return result


def _number_for(variable: Any, value: Value) -> Value:
    """The value, if it is one number: a whole one where the variable is no Real, one of an enumeration's items, 0 or 1."""
    if not isinstance(value, Real):
        raise InputError(f"{variable.name} must be one number, got {value!r}")
    if variable.type == "Boolean" and value not in (0, 1):
        raise InputError(f"{variable.name} must be true or false, got {value}")
    if variable.type != "Real" and value % 1 != 0:
        raise InputError(f"{variable.name} must be a whole number, got {value}")
    known = items(variable) if variable.type == "Enumeration" else {}
    if known and value not in known.values():
        names = ", ".join(f"{number} ({name})" for name, number in known.items())
        raise InputError(f"{variable.name} must be one of {names}, got {value}")
    return value


def items(variable: Any) -> dict[str, int]:
    """Name → number of the items of an enumeration or numbered choice; none of other variables."""
    declared = variable.declaredType
    return {item.name: int(item.value) for item in declared.items or ()} if declared else {}


def _in_range(variable: Any, value: Value) -> Value:
    """The value, if the variable's type and range allow it."""
    if variable.type not in ("Real", "Integer") or isinstance(value, str):
        return value
    # limits of the variable, or of its type
    low, high = (_bound(variable, bound) for bound in ("min", "max"))
    if (low is None or value >= low) and (high is None or value <= high) and abs(value) <= float_info.max:
        return value
    # else say which values are possible
    unit = _unit(variable)
    unit = "" if unit in ("", "1") else f" {unit}"
    limits = [f"at least {low:g}{unit}"] if low is not None else []
    limits += [f"at most {high:g}{unit}"] if high is not None else []
    raise InputError(f"{variable.name} must be {' and '.join(limits) or 'a finite number'}, got {value}{unit}")


def _bound(variable: Any, name: str) -> float | None:
    """A limit of the variable, or of its type where it has none itself."""
    for holder in (variable, variable.declaredType):
        text = getattr(holder, name, None)
        if text is not None:
            return float(text)
    return None


def _unit(variable: Any) -> str:
    """Unit of the variable or of its type; empty when unknown."""
    return variable.unit or (variable.declaredType.unit if variable.declaredType else None) or ""


def typed(variable: Any, value: Value) -> Value:
    """The value as the variable's type has it: of enumerations and numbered choices the number.

    Raises:
        InputError: the value has no such name, the variable takes one number alone, or whole ones, items or 0 and 1.
    """
    if variable.type == "String":
        return str(value)
    if variable.type == "Boolean" and isinstance(value, str) and value in _BOOLEANS:
        return _BOOLEANS[value]
    if not isinstance(value, str):
        return _number_for(variable, value)
    known = items(variable)
    if not known:
        raise InputError(f"{variable.name} is a number, got {value!r}")
    if value not in known:
        raise InputError(f"{variable.name} must be one of {', '.join(known)}, got {value!r}")
    return known[value]


def in_words(variable: Any, value: Value) -> str:
    """A value of the variable for messages, with its unit or its name."""
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
    """Whether two values of a variable agree, but for roundings."""
    if isinstance(value, str) or isinstance(found, str):
        return value == found
    return isclose(value, found, rel_tol=ROUNDING, abs_tol=0.0)
