"""Inputs, outputs and parameters of a user's controller from their names; the robot's signals have their units."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from math import isfinite

from flexfmu.cosim.control.controllers.joints import UNITS
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.symbolic import Causality, Variable

SIGNAL_UNITS = {
    **{rf"joint\d+\.(reference\.)?{kind}": unit for kind, unit in UNITS.items()},
    **{rf"end_effector\.(reference\.)?{kind}\.[xy]": unit.replace("rad", "m") for kind, unit in UNITS.items()},
    r"joint\d+\.(torque|feedforward|disturbance)": "N.m",
    r"force\.[xy]": "N",
    r"payload\.(mass|change)": "kg",
}
"""Signals of the robot → unit."""


def unit_of(name: str) -> str:
    """Return the unit of a signal of the robot by its name; ``1``, which connects to any unit, for other names."""
    return next((unit for pattern, unit in SIGNAL_UNITS.items() if re.fullmatch(pattern, name)), "1")


def named_signals(names: Sequence[str], causality: Causality, units: Mapping[str, str]) -> list[Variable]:
    """Return the inputs or outputs of these names.

    Args:
        names: names of the signals.
        causality: input or output.
        units: name → unit, where it isn't that of `unit_of`.

    Raises:
        InputError: the names aren't a list of texts.
    """
    if isinstance(names, str) or not all(isinstance(name, str) and name for name in names):
        raise InputError(f'{causality}s must be a list of names, such as ["joint1.position"], got {names!r}')
    start = 0.0 if causality == "input" else None
    return [
        Variable(name, units.get(name) or unit_of(name), f"{causality.capitalize()} {name}", causality, start)
        for name in names
    ]


def named_parameters(values: Mapping[str, float], units: Mapping[str, str]) -> list[Variable]:
    """Return the tunable parameters of these names and values; errors as for `check_units`.

    Raises:
        InputError: a value isn't a finite number.
    """
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
            raise InputError(f"the parameter {name!r} must be a finite number, got {value!r}")
    return [
        Variable(name, units.get(name, "1"), f"Parameter {name}", "parameter", float(value), tunable=True)
        for name, value in values.items()
    ]


def check_units(units: Mapping[str, str], names: Sequence[str], where: str) -> None:
    """Check that units belong to variables of these names.

    Raises:
        InputError: a name is none of a variable; the message has the nearest one.
    """
    for name in units:
        if name not in names:
            near = "".join(f"; did you mean {each!r}?" for each in get_close_matches(name, names, n=1, cutoff=0.0))
            raise InputError(f"{where}: `units` names {name!r}, which is no variable{near}")
