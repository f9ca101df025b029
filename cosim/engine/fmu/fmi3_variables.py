"""Model descriptions of FMI 3.0 in the form of FMI 2.0: arrays as scalar elements ``y[1]`` and ``A[1,2]``, row by row.

Structural parameters (they set the sizes of arrays) count as parameters; variables of type Binary are left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from attrs import asdict, define, evolve
from fmpy.model_description import ModelVariable, Unknown

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.calls import DTYPES
from flexfmu.cosim.engine.fmu.variables import Handle, Value, settable_variables, settings

_KINDS = {"Float32": "Real", "Float64": "Real", "Enumeration": "Enumeration", "Boolean": "Boolean", "String": "String"}
"""Types of FMI 3.0 → types of FMI 2.0; all others are Integer."""


@dataclass(frozen=True)
class ElementHandle(Handle):
    """Address of a scalar variable, or of an element of an array, for the FMI 3.0 functions.

    Attributes:
        name: name for messages.
        type: type whose functions transfer it, ``Float64`` for example.
        place: index of the element in its array, row by row; 0 for a scalar.
        size: number of elements of the array; 1 for a scalar.
        start: start values of the whole variable; None if unknown.
        discrete: whether it changes only at events.
        structural: whether it is a structural parameter.
    """

    name: str
    type: str
    place: int
    size: int
    start: tuple[float, ...] | None
    discrete: bool
    structural: bool


@define(eq=False)
class Element(ModelVariable):  # type: ignore[misc]
    """A scalar variable or an element of an array, with the types of FMI 2.0."""

    handle: ElementHandle | None = None
    array: str = ""
    """Name of its array; empty for a scalar."""


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
    # inputs, outputs, parameters, and variables that may be set before initialisation
    for variable in description.modelVariables:
        shown = variable.causality in ("input", "output", "parameter", "structuralParameter")
        used = shown or (variable.initial in ("exact", "approx") and variable.variability != "constant")
        if used and variable.type not in ("Binary", "Clock"):
            scalars = list(_elements(variable, sizes))
            variables += scalars
            elements.setdefault(variable.valueReference, []).extend(scalars)

    def known(variables: Sequence[Any] | None) -> list[Element] | None:
        return None if variables is None else [e for v in variables for e in elements.get(v.valueReference, [])]

    # each element of an output depends on all elements of the output's dependencies
    outputs = [
        Unknown(variable=element, dependencies=known(unknown.dependencies))
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
    given = {n: value for n, value in parameters.items() if n in known and _structural(known[n])}
    return {each.name: int(each.value) for each in settings(known, given)}


def by_elements(description: Any, parameters: Mapping[str, Any]) -> dict[str, Value]:
    """Return start values by element, structural parameters first; unchanged for an FMU of FMI 2.0.

    Raises:
        InputError: the number of values for an array isn't its number of elements.
    """
    # FMI 2.0 has no arrays, and variants of a scene ask at each run
    if description.fmiVersion.startswith("2."):
        return dict(parameters)
    elements = {each.name: each for each in description.modelVariables if isinstance(each, Element)}
    if not elements:
        return dict(parameters)
    # names of the elements of each array
    arrays: dict[str, list[str]] = {}
    for name, element in elements.items():
        if element.array:
            arrays.setdefault(element.array, []).append(name)
    single = {name: parameters[name] for name, each in elements.items() if _structural(each) and name in parameters}
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
    short = {name for name, each in elements.items() if each.handle is not None and each.handle.type == "Float32"}
    return {
        name: float(np.float32(value)) if name in short and isinstance(value, int | float) else value
        for name, value in single.items()
    }


def _structural(variable: Any) -> bool:
    """Return whether the variable is a structural parameter."""
    return isinstance(variable, Element) and variable.handle is not None and variable.handle.structural


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
            limits, stated = np.iinfo(DTYPES[variable.type]), (variable, variable.declaredType)
            for bound, limit in (("min", limits.min), ("max", limits.max)):
                if all(getattr(each, bound, None) is None for each in stated):
                    setattr(variable, bound, str(limit))


def _elements(variable: Any, sizes: Mapping[str, int]) -> Iterator[Element]:
    """Yield a scalar variable as it is, an array element by element."""
    # sizes of the dimensions, numbers or structural parameters; () for a scalar
    shape = tuple(
        int(each.start if each.start is not None else sizes.get(each.variable.name, each.variable.start))
        for each in variable.dimensions
    )
    names, texts = element_names(variable.name, shape), _starts(variable, prod(shape))
    handle = ElementHandle(
        kind="Integer" if variable.type == "Enumeration" else _KINDS.get(variable.type, "Integer"),  # type: ignore[arg-type]
        reference=variable.valueReference,
        name=variable.name,
        type="Int64" if variable.type == "Enumeration" else variable.type,
        place=0,
        size=prod(shape),
        start=_numbers(variable, texts),
        discrete=_KINDS.get(variable.type) != "Real" or variable.variability == "discrete",
        structural=variable.causality == "structuralParameter",
    )
    # all attributes read by fmpy, with names and types as in FMI 2.0
    causality = "parameter" if handle.structural else variable.causality
    plain = asdict(variable, recurse=False) | {"type": _KINDS.get(variable.type, "Integer"), "causality": causality}
    plain["python_type"] = plain.pop("_python_type")
    for place, name in enumerate(names):
        start = texts[place] if texts else None
        array = variable.name if shape else ""
        yield Element(
            **(plain | {"name": name, "start": start}), handle=replace(handle, name=name, place=place), array=array
        )


def element_names(name: str, shape: tuple[int, ...]) -> list[str]:
    """Return the names of all elements, row by row; of a scalar its own name."""
    return [f"{name}[{','.join(str(i + 1) for i in index)}]" for index in np.ndindex(shape)] if shape else [name]


def _starts(variable: Any, size: int) -> list[str] | None:
    """Return the start values of all elements; a single one applies to all. None if unknown."""
    if variable.start is None:
        return None
    texts = variable.start.split() if variable.dimensions and variable.type != "String" else [variable.start]
    texts = texts * size if len(texts) == 1 else texts
    return texts if len(texts) == size else None


def _numbers(variable: Any, texts: Sequence[str] | None) -> tuple[float, ...] | None:
    """Return start values as numbers; None for texts or if unknown."""
    if texts is None or variable.type == "String":
        return None
    spelt = {"true": 1, "false": 0}
    exact = int if "Int" in variable.type else float
    return tuple(spelt[text] if text in spelt else exact(text) for text in texts)
