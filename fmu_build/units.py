"""Unit names such as ``N.m`` or ``rad/s2``: exponents of the SI base units, display units and physical quantities."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import pi

from flexfmu.fmu_build.errors import ModelError

DIMENSIONLESS = "1"

COHERENT: Mapping[str, Mapping[str, int]] = {
    "1": {},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "K": {"K": 1},
    "rad": {"rad": 1},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
}
"""Coherent units → exponents of the base units; the models use no prefixes."""

_BASE_UNITS = ("kg", "m", "s", "A", "K", "rad")
"""Base units in the order of FMI's schema."""

_DEGREE = 180.0 / pi


@dataclass(frozen=True)
class DisplayUnit:
    """A display unit: displayed value = ``factor`` * value in the model's unit."""

    name: str
    factor: float


_DISPLAY_UNITS: Mapping[str, tuple[DisplayUnit, ...]] = {
    "rad": (DisplayUnit("deg", _DEGREE),),
    "rad/s": (DisplayUnit("deg/s", _DEGREE), DisplayUnit("rpm", 30.0 / pi)),
    "rad/s2": (DisplayUnit("deg/s2", _DEGREE),),
    "m": (DisplayUnit("mm", 1e3), DisplayUnit("um", 1e6)),
    "m/s": (DisplayUnit("mm/s", 1e3),),
    "s": (DisplayUnit("ms", 1e3),),
    "Pa": (DisplayUnit("GPa", 1e-9), DisplayUnit("MPa", 1e-6)),
}
"""Unit → display units; the first is the default, except for units in `_READ_AS_THEY_ARE`."""

_READ_AS_THEY_ARE = {"m/s", "s"}
"""Units that are themselves the default for display."""

_FACTOR = re.compile(r"(?P<sign>^|[./])(?P<symbol>1|[A-Za-z]+)(?P<power>\d*)")


@dataclass(frozen=True)
class Unit:
    """A unit of the model description.

    Attributes:
        name: name of the unit.
        exponents: base unit → exponent, without zeros, in the schema's order; the factor is 1.
        displays: display units.
    """

    name: str
    exponents: Mapping[str, int]
    displays: tuple[DisplayUnit, ...] = ()


_QUANTITIES: Mapping[str, str] = {
    "rad": "Angle",
    "rad/s": "AngularVelocity",
    "rad/s2": "AngularAcceleration",
    "rad/s3": "AngularJerk",
    "m": "Length",
    "m/s": "Velocity",
    "m/s2": "Acceleration",
    "m/s3": "Jerk",
    "m2": "Area",
    "m4": "SecondMomentOfArea",
    "kg": "Mass",
    "kg/m": "LinearDensity",
    "kg/m3": "Density",
    "kg.m2": "MomentOfInertia",
    "N": "Force",
    "N.m": "Torque",
    "N/m": "TranslationalSpringConstant",
    "N.m/rad": "RotationalSpringConstant",
    "N.s/m": "TranslationalDampingConstant",
    "N.m.s/rad": "RotationalDampingConstant",
    "N.m2": "FlexuralRigidity",
    "Pa": "Pressure",
    "J": "Energy",
    "W": "Power",
    "s": "Time",
    "Hz": "Frequency",
}
"""Unit → physical quantity, which is the name of a type in the model description."""


@dataclass(frozen=True)
class RealType:
    """A type of real variables.

    Attributes:
        name: name of the type and of the quantity, spelt as in the Modelica Standard Library.
        unit: unit of all its variables.
        display_unit: default display unit; None for the unit itself.
    """

    name: str
    unit: str
    display_unit: str | None


def unit_exponents(name: str) -> dict[str, int]:
    """Base unit → exponent of the unit ``name``; ``.`` multiplies, ``/`` divides by the next symbol only.

    Raises:
        ModelError: the name has an unknown symbol or a wrong syntax.
    """
    # factors of the name
    factors = list(_FACTOR.finditer(name))
    if "".join(factor.group() for factor in factors) != name or not factors:
        raise ModelError(f"unit '{name}' is not understood; write it like N.m or rad/s2")
    # sum of the exponents
    total = dict.fromkeys(_BASE_UNITS, 0)
    for factor in factors:
        symbol = factor["symbol"]
        if symbol not in COHERENT:
            raise ModelError(f"unit '{name}' has the unknown symbol '{symbol}'; known are {', '.join(COHERENT)}")
        power = int(factor["power"] or 1) * (-1 if factor["sign"] == "/" else 1)
        for base, exponent in COHERENT[symbol].items():
            total[base] += power * exponent
    return {base: exponent for base, exponent in total.items() if exponent}


def display_unit(name: str) -> str | None:
    """Default display unit of the unit ``name``; None for the unit itself."""
    return _DISPLAY_UNITS[name][0].name if name in _DISPLAY_UNITS and name not in _READ_AS_THEY_ARE else None


def displayed(value: float, unit: str) -> str | None:
    """A value in its default display unit, such as ``240 mm``; None for the unit itself."""
    name = display_unit(unit)
    return None if name is None else f"{value * _DISPLAY_UNITS[unit][0].factor:.6g} {name}"


def unit_definitions(names: Iterable[str]) -> tuple[Unit, ...]:
    """Definitions of the units in ``names``, unique and sorted, without the dimensionless one."""
    used = sorted(set(names) - {DIMENSIONLESS})
    return tuple(Unit(name, unit_exponents(name), _DISPLAY_UNITS.get(name, ())) for name in used)


def quantity(unit: str) -> str | None:
    """Name of the physical quantity with this unit; None if it has no name."""
    return _QUANTITIES.get(unit)


def real_types(units: Iterable[str]) -> tuple[RealType, ...]:
    """Types of variables with these units, unique and sorted by name."""
    named = {name: unit for unit in set(units) - {DIMENSIONLESS} if (name := quantity(unit)) is not None}
    return tuple(RealType(name, unit, display_unit(unit)) for name, unit in sorted(named.items()))
