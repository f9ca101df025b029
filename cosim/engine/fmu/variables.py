"""Variables of an FMU as slave variables, with their value references, and start values with their checks.

Variables of FMI 3.0 are turned into those of FMI 2.0: an array becomes one scalar variable per element, named ``A[1,2]``, and
structural parameters (they set the sizes of arrays) count as parameters; variables of type Binary are left out, and of the clocks all but
the triggered ones, which are Integers that count their ticks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from math import isclose, prod
from numbers import Real
from pathlib import Path
from sys import float_info
from typing import Any, cast
from xml.etree import ElementTree

import numpy as np
from attrs import asdict, define, evolve
from fmpy.model_description import ModelVariable, Unknown

from flexfmu.cosim.engine.errors import InputError, suggestion
from flexfmu.cosim.engine.fmu.calls import FMI3
from flexfmu.cosim.engine.slave import TEXTS, Causality, SlaveVariable
from flexfmu.fmu_build.fmi_clock import TRIGGERED

Value = float | int | bool | str
"""Value of a parameter; for an enumeration or a numbered choice also the item's name."""

_BOOLEANS = {"true": True, "false": False}
"""Booleans as FMI spells them."""

COUNTERS = "statistics."
"""Prefix of the names of counters."""

ROUNDING = 1e-12
"""Relative tolerance of values read back: an FMU that converts units may round them a few times."""


@dataclass(frozen=True)
class Handle:
    """Address of a scalar variable, or of an element of an array, for the FMI functions.

    Attributes:
        kind: Real, Integer (enumerations too), Boolean or String.
        reference: value reference.
        type: type whose functions transfer it, ``Float64`` for example.
        name: name for messages.
        place: index of the element in its array, row by row; 0 for a scalar.
        size: number of elements of the array; 1 for a scalar.
        start: start values of the whole array; None if unknown.
        discrete: whether an FMU of FMI 3.0 takes it at events only.
        structural: whether it is a structural parameter.
        clocks: value references of its clocks, in whose ticks alone it is set and read.
    """

    kind: str
    reference: int
    type: str
    name: str = ""
    place: int = 0
    size: int = 1
    start: tuple[float, ...] | None = None
    discrete: bool = False
    structural: bool = False
    clocks: tuple[int, ...] = ()


@dataclass(frozen=True)
class FmuVariables:
    """Variables of a model description.

    Attributes:
        connectable: inputs, outputs and numeric parameters, in the order of the model description; for model exchange then the
            states that aren't outputs, as outputs.
        handles: handle of each of them.
        others: name → handle of all other variables.
        feedthrough: output → inputs that it depends on at the same instant; outputs without stated dependencies are
            left out.
        rates: value reference and index of the element of a state in model exchange → handle of its derivative.
    """

    connectable: tuple[SlaveVariable, ...]
    handles: tuple[Handle, ...]
    others: Mapping[str, Handle]
    feedthrough: Mapping[str, tuple[str, ...]]
    rates: Mapping[tuple[int, int], Handle]


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
    # states and their derivatives, and the states that no output shows
    handles = [_handle(v) for v in description.modelVariables]
    rates = {
        (state, each.place): each
        for state, rate in continuous_states(description)
        for each in handles
        if each.reference == rate and each.kind == "Real"
    }
    own = [_handle(v) for v in connectable]
    seen, hidden = {(each.reference, each.place) for each in own if each.kind == "Real"}, []
    for variable, handle in zip(description.modelVariables, handles, strict=True):
        if handle.kind == "Real" and (place := (handle.reference, handle.place)) in rates.keys() - seen:
            seen.add(place)
            hidden.append(variable)
    shown = [_variable(v) for v in connectable] + [replace(_variable(v), causality="output") for v in hidden]
    depends |= {v.name: () for v in hidden}
    return FmuVariables(tuple(shown), (*own, *map(_handle, hidden)), others, depends, rates)


def continuous_states(description: Any) -> list[tuple[int, int]]:
    """Return the value references of each state and its derivative of an FMU for model exchange only; none for any other."""
    stated = description.derivatives if description.coSimulation is None else ()
    rates = [each.variable for each in stated or () if each.variable.derivative is not None]
    return [(each.derivative.valueReference, each.valueReference) for each in rates]


def _variable(variable: Any) -> SlaveVariable:
    """Return the variable for the master."""
    text = variable.type == "String"
    start = (
        None
        if variable.start is None
        else TEXTS.code(variable.start)
        if text
        else float(_BOOLEANS.get(variable.start, variable.start))
    )
    discrete = variable.type != "Real" or variable.variability == "discrete"
    return SlaveVariable(
        variable.name, cast(Causality, variable.causality), _unit(variable), start, discrete, variable.type
    )


def _handle(variable: Any) -> Handle:
    """Return the handle of the variable; variables of FMI 3.0 have their own."""
    if isinstance(variable, Element):
        return variable.handle
    kind = "Integer" if variable.type == "Enumeration" else variable.type
    return Handle(kind, variable.valueReference, kind, variable.name)


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
            raise InputError(f"the FMU has no parameter {name!r}; {suggestion(name, known)}")
        variable = known[name]
        lasting = variable.initial != "approx"
        result.append(Setting(name, _handle(variable), _in_range(variable, typed(variable, value)), lasting))
    return result


def items(variable: Any) -> dict[str, int]:
    """Return the items of an enumeration or numbered choice (name → number); empty for other variables."""
    declared = variable.declaredType
    return {item.name: int(item.value) for item in declared.items or ()} if declared else {}


def _in_range(variable: Any, value: Value) -> Value:
    """Return the value if it is within the variable's range; raise `InputError` otherwise."""
    if variable.type not in ("Real", "Integer") or isinstance(value, str):
        return value
    # limits of the variable, or else of its declared type
    stated = ([getattr(each, bound, None) for each in (variable, variable.declaredType)] for bound in ("min", "max"))
    low, high = (next((float(each) for each in texts if each is not None), None) for texts in stated)
    if (low is None or value >= low) and (high is None or value <= high) and abs(value) <= float_info.max:
        return value
    # otherwise state the possible values
    unit = _unit(variable)
    unit = "" if unit in ("", "1") else f" {unit}"
    limits = [f"at least {low:g}{unit}"] if low is not None else []
    limits += [f"at most {high:g}{unit}"] if high is not None else []
    raise InputError(f"{variable.name} must be {' and '.join(limits) or 'a finite number'}, got {value}{unit}")


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
    known = items(variable)
    # the name of an item
    if isinstance(value, str):
        if not known:
            raise InputError(f"{variable.name} is a number, got {value!r}")
        if value not in known:
            raise InputError(f"{variable.name} must be one of {', '.join(known)}, got {value!r}")
        return known[value]
    # a number that fits the type
    if not isinstance(value, Real):
        raise InputError(f"{variable.name} must be one number, got {value!r}")
    if variable.type == "Boolean" and value not in (0, 1):
        raise InputError(f"{variable.name} must be true or false, got {value}")
    if variable.type != "Real" and value % 1 != 0:
        raise InputError(f"{variable.name} must be a whole number, got {value}")
    if variable.type == "Enumeration" and known and value not in known.values():
        names = ", ".join(f"{number} ({name})" for name, number in known.items())
        raise InputError(f"{variable.name} must be one of {names}, got {value}")
    return value


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


_KINDS = {"Float32": "Real", "Float64": "Real", "Enumeration": "Enumeration", "Boolean": "Boolean", "String": "String"}
"""Types of FMI 3.0 → types of FMI 2.0; all others are Integer."""


@define(eq=False)
class Element(ModelVariable):  # type: ignore[misc]
    """A scalar variable or an element of an array, with the types of FMI 2.0.

    Attributes:
        handle: its address.
        array: name of its array; empty for a scalar.
    """

    handle: Handle = Handle("Real", 0, "Float64")
    array: str = ""


def flattened(description: Any, folder: Path, sizes: Mapping[str, int]) -> Any:
    """Return the model description with one scalar variable per element.

    Args:
        description: model description as fmpy reads it; ranges of integers are added to it.
        folder: folder of the unpacked FMU.
        sizes: structural parameter → value, if it isn't the start value of the description.
    """
    _add_ranges(description, folder)
    elements: dict[int, list[Element]] = {}
    variables: list[Element] = []
    # inputs, outputs, parameters, counters, states, and variables that may be set before initialisation
    states = {reference for pair in continuous_states(description) for reference in pair}
    for variable in description.modelVariables:
        shown = variable.causality in ("input", "output", "parameter", "structuralParameter")
        shown = shown or variable.name.startswith(COUNTERS) or variable.valueReference in states
        used = shown or (variable.initial in ("exact", "approx") and variable.variability != "constant")
        counts = variable.type == "Clock" and variable.intervalVariability == TRIGGERED
        if used and (counts or variable.type not in ("Binary", "Clock")):
            scalars = list(_elements(variable, sizes))
            variables += scalars
            elements.setdefault(variable.valueReference, []).extend(scalars)

    def known(unknown: Any) -> list[Element] | None:
        if unknown.dependencies is None:
            return None
        variables = dict.fromkeys([*unknown.dependencies, *(unknown.variable.clocks or ())])
        return [e for v in variables for e in elements.get(v.valueReference, [])]

    # each element of an output depends on all elements of the output's dependencies, and on its triggered clocks
    outputs = [
        Unknown(variable=element, dependencies=known(unknown))
        for unknown in description.outputs
        for element in elements.get(unknown.variable.valueReference, [])
    ]
    return evolve(description, modelVariables=variables, outputs=outputs)


def structural_sizes(description: Any, parameters: Mapping[str, Any]) -> dict[str, int]:
    """Return the structural parameters among these start values: name → value.

    Raises:
        InputError: a value doesn't fit its type or range.
    """
    # FMI 2.0 has none, and variants of a scene ask at each run
    if description.fmiVersion.startswith("2."):
        return {}
    known = settable_variables(description)
    given = {n: value for n, value in parameters.items() if n in known and known[n].handle.structural}
    return {each.name: int(each.value) for each in settings(known, given)}


def by_elements(description: Any, parameters: Mapping[str, Any]) -> dict[str, Value]:
    """Return start values by element, structural parameters first; unchanged for an FMU of FMI 2.0.

    Raises:
        InputError: the number of values for an array isn't its number of elements.
    """
    # FMI 2.0 has no arrays, and variants of a scene ask at each run
    if description.fmiVersion.startswith("2."):
        return dict(parameters)
    elements = {each.name: each for each in description.modelVariables}
    # names of the elements of each array
    arrays: dict[str, list[str]] = {}
    for name, element in elements.items():
        if element.array:
            arrays.setdefault(element.array, []).append(name)
    single = {
        name: parameters[name] for name, each in elements.items() if each.handle.structural and name in parameters
    }
    # a value for each element
    for name, value in parameters.items():
        names = arrays.get(name, [name])
        values = np.asarray(value, dtype=object).ravel().tolist() if name in arrays else [value]
        if len(values) != len(names):
            raise InputError(
                f"{name} is an array: give {len(names)} values, row by row, or single ones such as {names[0]}; "
                f"got {len(values)}"
            )
        single |= zip(names, values, strict=True)
    # single-precision values as they will be read back
    short = {name for name, each in elements.items() if each.handle.type == "Float32"}
    return {
        name: float(np.float32(value)) if name in short and isinstance(value, int | float) else value
        for name, value in single.items()
    }


def _add_ranges(description: Any, folder: Path) -> None:
    """Add the ranges of unsigned integers, which fmpy doesn't read, and the limits of the C types of all integers."""
    root = ElementTree.parse(folder / "modelDescription.xml").getroot()
    unsigned = {each.get("name"): each for each in root.iterfind("ModelVariables/*") if each.tag.startswith("UInt")}
    for variable in description.modelVariables:
        # the ranges that fmpy doesn't read
        if variable.name in unsigned:
            variable.min, variable.max = (unsigned[variable.name].get(bound) for bound in ("min", "max"))
        # no limit of its own or of its declared type: the limit of the C type
        if "Int" in variable.type:
            limits, stated = np.iinfo(FMI3.dtypes[variable.type]), (variable, variable.declaredType)
            for bound, limit in (("min", limits.min), ("max", limits.max)):
                if all(getattr(each, bound, None) is None for each in stated):
                    setattr(variable, bound, str(limit))


def _elements(variable: Any, sizes: Mapping[str, int]) -> Iterator[Element]:
    """Yield a scalar variable as it is, an array element by element, row by row."""
    # sizes of the dimensions, numbers or structural parameters; () for a scalar
    shape = tuple(
        int(each.start if each.start is not None else sizes.get(each.variable.name, each.variable.start))
        for each in variable.dimensions
    )
    name, size, kind = variable.name, prod(shape), _KINDS.get(variable.type, "Integer")
    names = [f"{name}[{','.join(str(i + 1) for i in index)}]" for index in np.ndindex(shape)] if shape else [name]
    # start values of all elements; a single one applies to all
    texts = ["0"] if variable.type == "Clock" else [] if variable.start is None else [variable.start]
    if variable.dimensions and variable.type != "String" and texts:
        texts = variable.start.split()
    texts = texts * size if len(texts) == 1 else texts if len(texts) == size else []
    exact = int if "Int" in variable.type else float
    start = tuple(exact(_BOOLEANS.get(text, text)) for text in texts) if texts and variable.type != "String" else None
    # all attributes read by fmpy, with names and types as in FMI 2.0
    structural = variable.causality == "structuralParameter"
    causality = "parameter" if structural else variable.causality
    plain = asdict(variable, recurse=False) | {"type": kind, "causality": causality}
    plain["python_type"] = plain.pop("_python_type")
    functions, array = "Int64" if kind == "Enumeration" else variable.type, name if shape else ""
    discrete = kind != "Real" or variable.variability == "discrete"
    kind = "Integer" if kind == "Enumeration" else kind
    clocks = tuple(each.valueReference for each in variable.clocks or ())
    common: dict[str, Any] = {"discrete": discrete, "structural": structural, "clocks": clocks}
    for place, (own, text) in enumerate(zip_longest(names, texts)):
        handle = Handle(kind, variable.valueReference, functions, own, place, size, start, **common)
        yield Element(**(plain | {"name": own, "start": text}), handle=handle, array=array)
