"""Flat names of variables, for tools that don't accept structured ones.

=====================================  ==========================  ==============================
Part of the structured name            in the flat name            example
=====================================  ==========================  ==============================
``.`` before a component               underscore                  ``link11.bending`` ``link11_bending``
``[i]``, ``[i,j]``                     underscore, number          ``bending[1]`` ``bending_1``
``der(name)``                          ``der_`` in front           ``der(joint1.velocity)`` ``der_joint1_velocity``
``der(name,n)``                        ``der`` n ``_`` in front    ``der(x.y,2)`` ``der2_x_y``
=====================================  ==========================  ==============================

An FMU with flat names lists the structured names in the vendor annotation `NAMES`. Two variables must not have the same flat
name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from flexfmu.fmu_build.errors import ModelError

if TYPE_CHECKING:  # the command line, which knows the names of the conventions, starts without models
    from flexfmu.model.symbolic import SymbolicBlock, SymbolicModel, Variable

Symbolic = TypeVar("Symbolic", "SymbolicModel", "SymbolicBlock")

Naming = Literal["structured", "flat"]
"""Naming convention of the variables; FMI's attribute ``variableNamingConvention``."""

_DERIVATIVE = re.compile(r"der\((?P<name>.+?)(?:,(?P<order>\d+))?\)")

NAMES = "Names"
"""Vendor annotation of an FMU with flat names: flat name → structured name, where they differ."""


def flat_name(name: str) -> str:
    """The flat name for a structured name.

    Raises:
        ModelError: the flat name would contain characters other than letters, digits and underscores, or begin with a
            digit or underscore.
    """
    derivative = _DERIVATIVE.fullmatch(name)
    flat = f"der{derivative['order'] or ''}_{_flat_path(derivative['name'])}" if derivative else _flat_path(name)
    if not re.fullmatch(r"[A-Za-z]\w*", flat, re.ASCII):
        raise ModelError(f"variable '{name}' has no flat name; use names like joint1.torque or link11.bending[1]")
    return flat


def _flat_path(path: str) -> str:
    return re.sub(r"[.,\[]", "_", path).replace("]", "")


def structured_names(names: Iterable[str]) -> dict[str, str]:
    """Flat name → structured name, for the variables where they differ.

    Raises:
        ModelError: a variable has no flat name, or two have the same.
    """
    structured: dict[str, str] = {}
    for name in names:
        other = structured.setdefault(flat_name(name), name)
        if other != name:
            raise ModelError(f"variables '{other}' and '{name}' have the same flat name, {flat_name(name)}; rename one")
    return {flat: name for flat, name in structured.items() if flat != name}


def namer(naming: Naming) -> Callable[[str], str]:
    """Function from a structured name to the name by a convention; it raises ModelError for one that has no flat name."""
    return flat_name if naming == "flat" else str


def named_variables(variables: Iterable[Variable], naming: Naming) -> tuple[Variable, ...]:
    """The variables with names by a convention, as the tables of the generated C have them.

    Raises:
        ModelError: a variable has no flat name.
    """
    name = namer(naming)
    return tuple(
        replace(each, name=name(each.name), derivative_of=each.derivative_of and name(each.derivative_of))
        for each in variables
    )


def named(model: Symbolic, naming: Naming) -> Symbolic:
    """A model or block with names of variables by a convention.

    Raises:
        ModelError: a variable has no flat name.
    """
    name = namer(naming)
    changes: dict[str, Any] = {
        causality: named_variables(getattr(model, causality), naming)
        for causality in ("inputs", "parameters", "outputs")
    }
    if hasattr(model, "unknowns"):
        changes["unknowns"] = tuple(map(name, model.unknowns))
    feedthrough = {name(output): tuple(map(name, inputs)) for output, inputs in model.feedthrough.items()}
    return replace(model, feedthrough=feedthrough, **changes)
